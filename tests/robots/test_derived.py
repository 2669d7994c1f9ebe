"""What follows from an MJCF, on a toy whose numbers are known; and what is refused, in one line."""

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.toy import FOOT, HALF_FOOT, HINGES, MASS, toy_mjcf
from zfall.robots import ZEROTH01, PushPoint, Robot, bare_model
from zfall.robots.anatomy import hips_of
from zfall.robots.declared import check_declared
from zfall.robots.symmetry import find_symmetry
from zfall.robots.units import factor, sized
from zfall.simulation.model import compile_model

SERVO = '<position joint="{name}" kp="40" kv="0.5" forcerange="-6 6"/>'


def toy(folder: Path, **changes: object) -> Robot:
    return Robot(name="toy", mjcf=str(toy_mjcf(folder, **changes)))


def test_a_toy_is_known_from_its_tree(tmp_path):
    robot = toy(tmp_path)
    assert robot.joints == tuple(f"{s}_{h}" for s in ("left", "right") for h in HINGES)
    assert robot.legs == robot.joints
    assert robot.mass == pytest.approx(MASS)
    assert robot.sole_half_size == pytest.approx(HALF_FOOT)
    assert robot.regions[:2] == ("torso", "left_thigh")
    assert robot.regions[-2:] == ("left_foot", "right_foot")
    assert robot.push_points["torso"] == PushPoint(body="trunk")
    assert [robot.joints[i] for i in hips_of(robot)] == ["left_hip", "right_hip"]
    assert robot.mirror["left_knee"] == "right_knee"
    assert set(robot.mirror_sign) == {-1.0}  # the axes of its right leg are turned around


def test_height_is_that_of_the_pose_that_the_servos_hold(tmp_path):
    """Straight legs: sum of m z, the lowest box's bottom on the floor."""
    robot = toy(tmp_path)
    masses = np.array([1.3, 0.6, 0.4, 0.2])
    hip, knee, ankle = 0.29, 0.16, 0.03  # the floor is 3 cm below the ankles
    heights = np.array([hip + 0.03 + 0.03, hip - 0.065, knee - 0.06, ankle - 0.02])
    expected = masses @ heights / masses.sum()
    assert robot.com_height == pytest.approx(expected, abs=2e-3)


def test_what_is_added_moves_nothing(tmp_path):
    """The physics of the completed toy is that of its MJCF, which MuJoCo reads by itself.

    But for the integrator, and the floor that the MJCF lacks.
    """
    robot = toy(tmp_path, actuator=SERVO)
    floor = '<worldbody><geom type="plane" size="0 0 1" friction="1 0.005 0.0001"/></worldbody>'
    plain = mujoco.MjModel.from_xml_path(str(toy_mjcf(tmp_path, actuator=SERVO, more=floor)))
    assert plain.nsensor == plain.nsite == plain.nkey == 0
    plain.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    whole = bare_model(robot)
    stand, states = whole.key("stand"), []
    for model in (whole, plain):
        data = mujoco.MjData(model)
        data.qpos[:], data.ctrl[:] = stand.qpos, stand.ctrl
        data.qvel[:6] = [0.3, 0.1, 0.0, 0.0, 0.0, 6.0]  # it turns on its soles
        mujoco.mj_step(model, data, 200)
        assert data.ncon >= 4  # on the floor
        states.append(data.qpos.copy())
    np.testing.assert_array_equal(*states)


def test_names_that_an_mjcf_refers_to_may_be_those_that_are_replaced(tmp_path):
    """A plane ``ground`` in a pair and a contact sensor, and an actuator in a sensor."""
    foot = FOOT.replace("<geom", '<geom name="{side}"')
    more = (
        '<worldbody><geom name="ground" type="plane" size="0 0 1"/></worldbody>'
        '<contact><pair geom1="left" geom2="ground" friction="0.7 0.7 0.005 0.0001 0.0001"/>'
        '<pair geom1="ground" geom2="right"/></contact>'
        '<sensor><actuatorfrc name="torque" actuator="left_hip_motor"/>'
        '<contact name="first" geom1="left" geom2="ground" data="force" reduce="netforce"/>'
        '<contact name="other" geom1="ground" geom2="right" data="force" reduce="netforce"/></sensor>'
        '<custom><tuple name="both"><element objtype="actuator" objname="left_hip_motor"/>'
        '<element objtype="geom" objname="ground"/></tuple></custom>'
    )
    model = bare_model(toy(tmp_path, foot=foot, more=more))
    floor, left, right = (model.geom(name).id for name in ("floor", "left", "right"))
    pairs = {frozenset(p) for p in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    assert pairs == {frozenset((floor, left)), frozenset((floor, right))}
    assert model.sensor("torque").objid[0] == model.actuator("left_hip").id
    assert list(model.tuple_objid) == [model.actuator("left_hip").id, floor]
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 1000)
    weight = sum(abs(data.sensor(name).data[2]) for name in ("first", "other"))
    assert weight == pytest.approx(MASS * 9.81, rel=0.02)
    np.testing.assert_array_equal(data.sensor("torque").data, data.actuator("left_hip").force)


def test_actuators_may_have_the_names_of_other_joints(tmp_path):
    """The sensor of the actuator that drives the right hip still is that of the right hip."""
    path = toy_mjcf(tmp_path, more='<sensor><actuatorfrc name="s" actuator="left_hip"/></sensor>')
    text = path.read_text()
    for side, other in (("left", "right"), ("right", "left")):
        text = text.replace(f'"{side}_hip_motor"', f'"{other}_hip"')
    path.write_text(text)
    model = bare_model(Robot(name="toy", mjcf=str(path)))
    assert model.sensor("s").objid[0] == model.actuator("right_hip").id


def test_what_is_only_seen_is_left_out_of_the_physics_and_kept_for_pictures(tmp_path):
    shell = '<geom size="0.05" contype="0" conaffinity="0" mass="0"/>'
    robot = toy(tmp_path, foot=FOOT + shell)
    stepped, shown = (compile_model(robot, physics_dt=0.004, look=look) for look in (False, True))
    assert shown.ngeom == stepped.ngeom + 2
    assert shown.nq == stepped.nq
    assert shown.camera("track").id >= 0


def test_a_foot_with_a_toe_has_one_sole(tmp_path):
    toe = (
        FOOT + '<body name="{side}_toe" pos="0.08 0 -0.02"><joint name="{side}_toe" axis="0 1 0" '
        'stiffness="5" range="-1 1"/><geom type="box" size="0.02 0.03 0.01" pos="0.02 0 0" '
        'mass="0.02"/></body>'
    )
    robot = toy(tmp_path, foot=toe)
    assert robot.sole_half_size == pytest.approx((0.08, 0.03))
    assert robot.additions.regions["left_foot"] == ("left_sole", "left_toe")
    assert len(robot.joints) == 6  # nothing drives the toes
    model = bare_model(robot)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(400):
        mujoco.mj_step(model, data)
    weight = -sum(data.sensor(f"feet_contact/{foot}").data[3] for foot in robot.feet)
    assert weight == pytest.approx(robot.mass * 9.81, rel=0.02)


def test_an_asymmetric_toy_says_so(tmp_path):
    robot = toy(tmp_path, right=0.99, more="")
    assert robot.mirror  # 1 % is not seen
    with pytest.raises(ValueError, match="servos must hold|same|sides|lowest"):
        toy(tmp_path, right=0.7)
    text = toy_mjcf(tmp_path).read_text()
    lame = text.replace('name="left_hip" axis="0 1 0"', 'name="left_hip" axis="0.8 0.6 0"')
    (tmp_path / "toy.xml").write_text(lame)
    robot = Robot(name="toy", mjcf=str(tmp_path))
    with pytest.raises(ValueError, match="toy must be symmetric .* symmetry=none"):
        assert robot.mirror_index


def test_the_mirror_of_the_default_robot_is_found_as_it_is_declared():
    found = find_symmetry(bare_model(ZEROTH01), ZEROTH01.joints)
    assert found is not None
    assert found.partner == ZEROTH01.mirror_index
    assert found.sign == ZEROTH01.mirror_sign


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"free": ""}, "must have a free joint, it has none"),
        ({"foot": '<geom type="box" size="0.06 0.03 0.01" mass="0.1" contype="0" conaffinity="0"/>',
          "more": ""}, "it falls: after"),
        ({"foot": '<geom size="0.01" pos="0 0 -0.02" mass="0.1"/>'}, "it falls: after"),
        ({"key": 'qpos="0 0 0.3 1 0 0 0 1.2 0 0 -1.2 0 0"'}, "it falls: after"),
        ({"actuator": '<motor joint="{name}"/>'}, "left_hip must have a largest torque"),
        ({"actuator": '<velocity joint="{name}" kv="1" forcerange="-1 1"/>'}, "must be a motor"),
        ({"actuator": ""}, "must have actuators on hinge joints, it has none"),
        ({"actuator": '<motor joint="{name}" ctrlrange="-1 1"/><motor joint="{name}"/>'}, "one actuator"),
        ({"foot": '<geom type="mesh" mesh="gone" mass="0.1"/>',
          "more": "<asset><mesh name='gone' file='gone.stl'/></asset>"}, "gone.stl"),
        ({"more": "<nonsense/>"}, "mjcf must be an MJCF"),
    ],
)  # fmt: skip
def test_a_toy_that_is_no_humanoid_is_refused_in_one_line(tmp_path, change, says):
    with pytest.raises(ValueError, match=says) as refused:
        toy(tmp_path, **change)
    assert "\n" not in str(refused.value)
    assert "toy.xml" in str(refused.value)


@pytest.mark.parametrize(
    ("mjcf", "says"),
    [
        ("gone.xml", "there is no .*gone.xml"),
        ("no_such_package:robot.xml", r"no_such_package is not: pip install 'zfall\[robots\]'"),
    ],
)
def test_an_mjcf_that_is_not_there_is_refused(tmp_path, mjcf, says):
    place = mjcf if ":" in mjcf else str(tmp_path / mjcf)
    with pytest.raises(ValueError, match=says):
        Robot(name="toy", mjcf=place)


def test_a_robot_that_its_servos_do_not_hold_can_be_meant_so(tmp_path):
    """Its height is then that of the pose, before it sinks into its servos."""
    leaning = 'qpos="0 0 0.3 1 0 0 0 1.2 0 0 -1.2 0 0"'
    with pytest.raises(ValueError, match="held: false if that is meant"):
        toy(tmp_path, key=leaning)
    stiff = toy(tmp_path)
    soft = Robot(name="toy", mjcf=stiff.mjcf, held=False)
    data = mujoco.MjData(model := bare_model(soft))
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    assert soft.com_height == pytest.approx(float(data.subtree_com[1, 2]))
    assert soft.com_height == pytest.approx(stiff.com_height, rel=0.02)
    assert soft.com_height > stiff.com_height  # which has sunk into its servos
    (tmp_path / "soft").mkdir()
    lean = Robot(name="toy", mjcf=str(toy_mjcf(tmp_path / "soft", key=leaning)), held=False)
    assert lean.com_height > 0


def test_a_foot_that_meets_the_floor_by_a_pair_alone_is_one(tmp_path):
    """As in MuJoCo Playground, whose other geoms meet nothing."""
    foot = (
        '<geom name="{side}" type="box" size="0.06 0.03 0.01" mass="0.1" contype="0" '
        'conaffinity="0"/>'
    )
    pairs = "".join(f'<pair geom1="{side}" geom2="floor"/>' for side in ("left", "right"))
    floor = '<worldbody><geom name="floor" type="plane" size="0 0 1"/></worldbody>'
    robot = toy(tmp_path, foot=foot, more=f"{floor}<contact>{pairs}</contact>")
    assert robot.sole_half_size == pytest.approx((0.06, 0.03))


def test_of_a_folder_with_several_mjcf_the_file_must_be_named(tmp_path):
    toy_mjcf(tmp_path)
    (tmp_path / "scene.xml").write_text("<mujoco/>")
    assert Robot(name="toy", mjcf=str(tmp_path)).mjcf.endswith("toy.xml")  # a scene is none
    (tmp_path / "other.xml").write_text("<mujoco/>")
    with pytest.raises(ValueError, match=r"has other.xml, scene.xml, toy.xml: name the file"):
        Robot(name="toy", mjcf=str(tmp_path))


@pytest.mark.parametrize(
    ("declared", "says"),
    [
        ({"mass": 4.0}, "mass of zeroth01 must be that of its MJCF, 3.349 kg, got 4 kg"),
        ({"com_height": 0.3}, "com_height .* 0.2202 m, got 0.3 m"),
        ({"stand": {"left_knee_pitch": -0.3}}, "stand of zeroth01 .* keyframe"),
        ({"mirror_keeps_sign": ("knee",)}, "mirror of zeroth01 must exchange its sides"),
    ],
)
def test_what_is_declared_against_the_model_is_refused(declared, says):
    with pytest.raises(ValueError, match=says):
        check_declared(replace(ZEROTH01, **declared))


def test_what_a_derived_robot_declares_is_held_against_its_model(tmp_path):
    robot = Robot(name="toy", mjcf=str(toy_mjcf(tmp_path)), mass=3.0)
    with pytest.raises(ValueError, match=re.escape("mass of toy must be that of its MJCF, 2.5 kg")):
        compile_model(robot, physics_dt=0.004)


def test_numbers_of_another_size_have_the_same_dimensionless_value(tmp_path):
    """Push of I for T sqrt(h / g), speed v / sqrt(g h)."""
    robot = toy(tmp_path)
    longer = robot.com_height / ZEROTH01.com_height
    assert factor(robot, "time") == pytest.approx(longer**0.5)
    assert factor(robot, "rate") == pytest.approx(longer**-0.5)
    given = {"_target_": "zfall.robots.Robot", "name": "toy", "mjcf": robot.mjcf}
    assert sized(0.32, "speed", given) == pytest.approx(0.32 * longer**0.5, rel=1e-3)
    with pytest.raises(ValueError, match="unit must be one of length, time"):
        factor(robot, "area")
