"""Compiling a robot's MJCF: push points, and what is refused."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from zfall.robots import ZEROTH01, PushPoint
from zfall.simulation.model import compile_model, identity_of, push_targets


def edited(tmp_path, old: str, new: str):
    """The robot with a changed MJCF."""
    text = open(ZEROTH01.mjcf).read()
    assert old in text
    path = tmp_path / "edited.xml"
    path.write_text(text.replace(old, new))
    return replace(ZEROTH01, mjcf=str(path))


@pytest.mark.parametrize(("point", "height"), [
    # Above the floor when standing [m]: facts of the robot, and offsets in base axes from them.
    ("torso", 0.305), ("pelvis", None), ("chest", None),
])  # fmt: skip
def test_push_points_lie_where_they_are_said_to_lie(point, height):
    model = compile_model(ZEROTH01, physics_dt=0.004)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    spot = data.body(f"push_point/{point}").xipos  # where MuJoCo applies forces
    base = data.body("floating_base_link").xpos
    offset = {"torso": None, "pelvis": -0.089, "chest": 0.026}[point]
    if height is not None:
        assert spot[2] == pytest.approx(height, abs=1e-3)
        np.testing.assert_allclose(spot, data.body("Top_Brace").xipos, atol=1e-9)
    else:
        np.testing.assert_allclose(spot - base, [0, 0, offset], atol=1e-9)


def test_elbow_push_point_is_the_left_elbow_joint():
    model = compile_model(ZEROTH01, physics_dt=0.004)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    spot = data.body("push_point/elbow").xipos
    np.testing.assert_allclose(spot, data.joint("left_elbow_roll").xanchor, atol=1e-9)


def test_push_points_change_neither_mass_nor_motion():
    plain = mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)
    ours = compile_model(ZEROTH01, physics_dt=plain.opt.timestep)
    ends = []
    for model in (plain, ours):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qvel[:3] = [0.3, 0.2, 0.1]
        for _ in range(100):
            mujoco.mj_step(model, data)
        ends.append(data.qpos.copy())
    assert ours.body_mass.sum() == pytest.approx(plain.body_mass.sum(), rel=1e-12)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_push_targets_name_points_and_links():
    model = compile_model(
        ZEROTH01, physics_dt=0.004, push_points={"toe": PushPoint(body="Left_Foot")}
    )
    targets = push_targets(model)
    assert set(ZEROTH01.push_points) | {"toe", "Left_Foot", "Top_Brace"} <= set(targets)
    assert model.body(targets["Left_Foot"] + 1).name == "Left_Foot"
    assert model.body(targets["toe"] + 1).name == "push_point/toe"


def test_limp_robot_falls_where_a_powered_one_stands():
    heights = []
    for powered in (True, False):
        model = compile_model(ZEROTH01, physics_dt=0.004, powered=powered)
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(500):
            mujoco.mj_step(model, data)
        heights.append(data.qpos[2])
    assert heights[0] > 0.32
    assert heights[1] < 0.2


def test_mjcf_without_a_sensor_is_refused_by_name(tmp_path):
    robot = edited(tmp_path, '<subtreelinvel name="com_velocity"', '<subtreelinvel name="other"')
    with pytest.raises(ValueError, match="must have a sensor for every key, lacks com_velocity"):
        compile_model(robot, physics_dt=0.004)


def test_mjcf_without_an_actuator_is_refused_by_name(tmp_path):
    robot = edited(tmp_path, '<position name="left_hip_yaw" ', '<position name="left_hip_jaw" ')
    with pytest.raises(ValueError, match="lacks the actuator left_hip_yaw"):
        compile_model(robot, physics_dt=0.004)


def test_push_point_on_an_unknown_link_is_refused_with_a_list():
    with pytest.raises(
        ValueError, match=r"push_points.tail: body must be one of .*Top_Brace.* got"
    ):
        compile_model(ZEROTH01, physics_dt=0.004, push_points={"tail": PushPoint(body="Tail")})


def test_a_push_point_at_a_site_lies_where_the_site_lies():
    model = compile_model(
        ZEROTH01, physics_dt=0.004, push_points={"sole": PushPoint(site="left_sole")}
    )
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_kinematics(model, data)
    point, site = data.body("push_point/sole"), data.site("left_sole")
    np.testing.assert_allclose(point.xipos, site.xpos, atol=1e-12)


@pytest.mark.parametrize(("point", "message"), [
    (PushPoint(site="tail"), "push_points.x: site must be one of .*left_sole.*got 'tail'"),
    (PushPoint(site="left_sole", offset=(0, 0, 0.1)), "push_points.x: offset must go with a body"),
    (PushPoint(), "push_points.x: give just one of body and site"),
    (PushPoint(body="Top_Brace", site="imu"), "give just one of body and site"),
])  # fmt: skip
def test_push_points_that_are_nowhere_are_refused(point, message):
    with pytest.raises(ValueError, match=message):
        compile_model(ZEROTH01, physics_dt=0.004, push_points={"x": point})


def test_a_push_point_cannot_take_the_name_of_a_link():
    with pytest.raises(
        ValueError, match=r"push_points.Top_Brace: must not have the name of a link"
    ):
        compile_model(ZEROTH01, physics_dt=0.004, push_points={"Top_Brace": PushPoint(site="imu")})


def test_an_actuator_that_the_robot_does_not_name_is_refused(tmp_path):
    more = '<actuator><motor name="tail" joint="left_hip_yaw"/></actuator></mujoco>'
    with pytest.raises(ValueError, match="each of robot.joints alone, also has tail"):
        compile_model(edited(tmp_path, "</mujoco>", more), physics_dt=0.004)


def test_identity_follows_the_physics_and_not_the_comments(tmp_path):
    mine = identity_of(ZEROTH01)
    assert identity_of(edited(tmp_path, "<worldbody>", "<worldbody><!-- here -->")) == mine
    assert mine.startswith("zeroth01 ")


@pytest.mark.parametrize(("old", "new"), [
    ('damping="1.3464', 'damping="1.4464'),
    ('<option timestep="0.004" ', '<option timestep="0.004" gravity="0 0 -1.6" '),
    ('<option timestep="0.004" ', '<option timestep="0.004" density="1.2" '),
    ('condim="3"', 'condim="1"'),
    ('condim="3"', 'condim="3" solref="0.1 1"'),
    ('<position name="left_hip_yaw" ', '<position name="left_hip_yaw" gear="2" '),
    ('<joint name="left_hip_yaw" ', '<joint name="left_hip_yaw" pos="0 0.03 0" '),
    ('<site name="imu" ', '<site name="imu" pos="0.01 0 0" '),
])  # fmt: skip
def test_identity_is_another_where_the_robot_moves_or_senses_otherwise(tmp_path, old, new):
    assert identity_of(edited(tmp_path, old, new)) != identity_of(ZEROTH01)
