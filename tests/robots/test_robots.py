"""The robot read back from its compiled model, against the published numbers."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from zfall.robots import ZEROTH01

PUBLISHED = json.loads((Path(__file__).parent / "published_zbot.json").read_text())["bodies"]

# Identified servos: the position loop gives duty = kp error_gain (target - q), clipped to max_pwm, and
# the motor torque = duty vin kt / R.
STS3250 = {"vin": 12.1, "kt": 1.0005874626213263, "R": 1.3890462492623645, "max_pwm": 0.97,
           "error_gain": 0.16293639, "damping": 1.3464038511725651,
           "armature": 0.03999977737144798, "frictionloss": 0.19999504581400715}  # fmt: skip
STS3215 = {"vin": 12.1, "kt": 1.0000000244338463, "R": 2.2136477795617733, "max_pwm": 0.9964,
           "error_gain": 0.16292703, "damping": 1.2305092028680242,
           "armature": 0.039999999991812, "frictionloss": 0.16197241014297026}  # fmt: skip


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)


@pytest.fixture(scope="module")
def published() -> mujoco.MjModel:
    """The published tree, built anew from its table of frames, inertials and hinges."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies = {"world": spec.worldbody}
    for row in PUBLISHED:
        body = bodies[row["parent"]].add_body(name=row["name"], pos=row["pos"], quat=row["quat"])
        if "mass" in row:
            body.mass, body.ipos, body.inertia = row["mass"], row["com"], row["inertia"]
            body.explicitinertial = True
        else:  # the root's marker sphere, 1 cm, of the density of water
            body.add_freejoint(name="floating_base")
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0])
        if "joint" in row:
            body.add_joint(
                name=row["joint"], type=mujoco.mjtJoint.mjJNT_HINGE, axis=row["axis"],
                range=row["range"], limited=True,
            )  # fmt: skip
        bodies[row["name"]] = body
    return spec.compile()


def random_pose(model: mujoco.MjModel, rng: np.random.Generator) -> np.ndarray:
    angles = rng.uniform(*model.jnt_range[1:].T)
    quaternion = rng.normal(size=4)
    return np.concatenate([[0, 0, 1], quaternion / np.linalg.norm(quaternion), angles])


def test_total_mass_is_the_published_one(model):
    assert model.body_mass.sum() == pytest.approx(3.3494, rel=1e-4)
    assert ZEROTH01.mass == pytest.approx(model.body_mass.sum(), rel=1e-4)


def test_joints_have_the_published_names_and_ranges(model, published):
    names = [model.joint(i).name for i in range(model.njnt)]
    assert names == [published.joint(i).name for i in range(published.njnt)]
    np.testing.assert_allclose(model.jnt_range, published.jnt_range)
    assert sorted(names[1:]) == sorted(ZEROTH01.joints)


def test_inertia_matrix_and_feet_agree_with_the_published_tree_in_100_poses(model, published):
    rng = np.random.default_rng(0)
    bare = mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)
    bare.dof_armature[:] = 0
    ours, theirs = mujoco.MjData(bare), mujoco.MjData(published)
    for _ in range(100):
        ours.qpos[:] = theirs.qpos[:] = random_pose(bare, rng)
        matrices = []
        for m, d in ((bare, ours), (published, theirs)):
            mujoco.mj_forward(m, d)
            matrices.append(np.zeros((m.nv, m.nv)))
            mujoco.mj_fullM(m, d, matrices[-1])
        scale = np.sqrt(np.outer(*[np.diag(matrices[1])] * 2))
        assert np.abs((matrices[0] - matrices[1]) / scale).max() < 1e-4
        for foot in ("Left_Foot", "Right_Foot"):
            gap = ours.body(foot).xpos - theirs.body(foot).xpos
            assert np.abs(gap).max() < 1e-6


@pytest.mark.parametrize(("joint", "servo", "kp"), [
    ("left_knee_pitch", STS3250, 22), ("right_hip_yaw", STS3250, 22),
    ("left_shoulder_roll", STS3250, 16), ("right_elbow_roll", STS3215, 16),
    ("left_gripper_roll", STS3215, 16),
])  # fmt: skip
def test_servos_have_the_identified_gains(model, joint, servo, kp):
    torque_per_duty = servo["vin"] * servo["kt"] / servo["R"]
    actuator, dof = model.actuator(joint), model.joint(joint).dofadr[0]
    stiffness = kp * servo["error_gain"] * torque_per_duty
    assert actuator.gainprm[0] == pytest.approx(stiffness, rel=1e-5)
    assert actuator.biasprm[1] == pytest.approx(-stiffness, rel=1e-5)
    limit = servo["max_pwm"] * torque_per_duty
    np.testing.assert_allclose(actuator.forcerange, [-limit, limit], rtol=1e-5)
    assert model.dof_damping[dof] == pytest.approx(servo["damping"])
    assert model.dof_armature[dof] == pytest.approx(servo["armature"])
    assert model.dof_frictionloss[dof] == pytest.approx(servo["frictionloss"])


def test_every_servo_belongs_to_one_of_the_tested_kinds(model):
    for joint in ZEROTH01.joints:
        legs = any(part in joint for part in ("hip", "knee", "ankle"))
        shoulder = "shoulder" in joint
        expected = 31.24 if legs else 22.72 if shoulder else 14.25
        assert model.actuator(joint).gainprm[0] == pytest.approx(expected, abs=0.01)


def test_standing_robot_keeps_still_at_the_published_height(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 1e-3
    assert data.qpos[2] == pytest.approx(0.331, abs=5e-4)
    assert data.subtree_com[1, 2] == pytest.approx(ZEROTH01.com_height, abs=5e-4)


def test_stand_keyframe_is_the_reference_pose(model):
    key = model.key("stand")
    for joint in ZEROTH01.joints:
        angle = ZEROTH01.stand.get(joint, 0.0)
        assert key.qpos[model.joint(joint).qposadr[0]] == pytest.approx(angle)
        assert key.ctrl[model.actuator(joint).id] == pytest.approx(angle)


def test_postures_are_keyframes_and_have_a_name(model):
    key = model.key("kneel")
    for joint, angle in zip(ZEROTH01.joints, ZEROTH01.posture("kneel"), strict=True):
        assert key.ctrl[model.actuator(joint).id] == pytest.approx(angle)
    with pytest.raises(ValueError, match="zeroth01 .* 'sit'; it has kneel"):
        ZEROTH01.posture("sit")


def test_every_link_can_touch_the_floor(model):
    floor = model.geom("floor")
    for body in range(1, model.nbody):
        name = model.body(body).name
        own = [model.geom(i) for i in range(model.ngeom) if model.geom_bodyid[i] == body]
        meets = [
            g for g in own if (g.contype & floor.conaffinity) | (floor.contype & g.conaffinity)
        ]
        assert meets, f"{name} has no geom that meets the floor"


def test_friction_of_a_foot_decides_over_that_of_the_floor():
    """On a slope of 0.3 a block of feet with friction 0.2 slides, one with 1.0 does not."""
    slides = []
    for friction in (0.2, 1.0):
        model = mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)
        for foot in ("left_foot", "right_foot"):
            model.geom(foot).friction[0] = friction
        model.opt.gravity[:] = [9.81 * np.sin(0.3), 0, -9.81 * np.cos(0.3)]
        model.dof_damping[6:] = 1e3  # stiff as a block
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(40):
            mujoco.mj_step(model, data)
        slides.append(data.site("left_sole").xpos[0] - (-0.0065))
    assert slides[0] > 0.01
    assert abs(slides[1]) < 0.003


def test_mirrored_poses_are_mirror_images(model):
    """Feet and hands swap sides within the published asymmetry of 2.2 mm (hands: 3 mm)."""
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    index, sign = np.array(ZEROTH01.mirror_index), np.array(ZEROTH01.mirror_sign)
    qpos = [model.joint(j).qposadr[0] for j in ZEROTH01.joints]
    low, high = model.jnt_range[[model.joint(j).id for j in ZEROTH01.joints]].T
    flip = np.array([1, -1, 1])
    for _ in range(20):
        angles = rng.uniform(0.4 * low, 0.4 * high)
        spots = []
        for pose in (angles, sign * angles[index]):
            mujoco.mj_resetData(model, data)
            data.qpos[qpos] = pose
            mujoco.mj_forward(model, data)
            ends = ("Left_Foot", "Right_Foot", "Left_Finger", "Right_Finger")
            spots.append(np.array([data.body(b).xipos - data.qpos[:3] for b in ends]))
        assert np.abs(spots[1][[1, 0, 3, 2]] * flip - spots[0]).max() < 4e-3


def test_impulse_of_size_one_is_that_of_the_docs():
    assert ZEROTH01.impulse_unit == pytest.approx(4.92, abs=0.005)  # m sqrt(g h0)


def test_joints_of_the_legs_are_those_that_lead_to_the_feet(model):
    between = set()
    for foot in ZEROTH01.feet:
        body = int(model.site(f"{foot}_sole").bodyid[0])
        while body:
            first = model.body_jntadr[body]
            if model.body_jntnum[body] and model.jnt_type[first] == mujoco.mjtJoint.mjJNT_HINGE:
                between.add(model.joint(int(first)).name)
            body = model.body_parentid[body]
    assert set(ZEROTH01.legs) == between
    assert [ZEROTH01.joints[i] for i in ZEROTH01.index_of("legs")] == list(ZEROTH01.legs)
    assert ZEROTH01.index_of("all") == tuple(range(20))
    with pytest.raises(ValueError, match="joints must be all or legs, got 'arms'"):
        ZEROTH01.index_of("arms")
