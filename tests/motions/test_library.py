"""Reference motions against MuJoCo's own kinematics and dynamics of the robot."""

from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from zfall.motions.library import gaits_of, load_motions, make_motions, motions_file, walk
from zfall.robots import ZEROTH01

GAITS, MOTIONS = gaits_of(ZEROTH01), load_motions(ZEROTH01)
WALKS = [name for name in MOTIONS if name != "standing"]
STEP, DOUBLE = 0.3, 0.03  # step time and double support [s]
OMEGA = (9.81 / 0.22) ** 0.5  # [1/s]
TIME = DOUBLE / 2 + 0.01 * np.arange(60)  # of the states of a walk [s], 0 when the left foot lands
SINGLE = {"left": slice(0, 28), "right": slice(30, 58)}  # the other foot swings
STANCE = {"left": slice(0, 31), "right": slice(27, 60)}
walks = pytest.mark.parametrize("name", WALKS)


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)


def poses(model, states):
    """The robot in MuJoCo, in each state in turn."""
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in ZEROTH01.joints]
    for k in range(len(states["joint_position"])):
        data.qpos[:3], data.qpos[3:7] = states["base_position"][k], states["base_orientation"][k]
        data.qvel[:3] = states["base_linear_velocity"][k]
        data.qvel[3:6] = states["base_angular_velocity"][k]
        for j, joint in enumerate(joints):
            data.qpos[joint.qposadr[0]] = states["joint_position"][k, j]
            data.qvel[joint.dofadr[0]] = states["joint_velocity"][k, j]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        yield data


def soles(model, states, side):
    """Positions ``(T, 3)`` and rotations of a sole."""
    found = [
        (data.site(f"{side}_sole").xpos.copy(), data.site(f"{side}_sole").xmat.reshape(3, 3).copy())
        for data in poses(model, states)
    ]
    return np.array([place for place, _ in found]), Rotation.from_matrix([m for _, m in found])


def test_the_shipped_file_is_what_the_code_makes():
    made = make_motions(ZEROTH01, GAITS)
    assert list(made) == list(MOTIONS)
    for name, motion in made.items():
        assert motion.period == pytest.approx(MOTIONS[name].period)
        for key, value in motion.states.items():
            np.testing.assert_allclose(MOTIONS[name].states[key], value, atol=2e-6)
    assert motions_file(ZEROTH01).stat().st_size < 200_000


def test_standing_is_the_reference_pose_at_rest(model):
    states = MOTIONS["standing"].states
    np.testing.assert_allclose(states["joint_position"][0], ZEROTH01.stand_position, atol=1e-7)
    for key in ("joint_velocity", "base_linear_velocity", "base_angular_velocity"):
        assert not states[key].any()


@walks
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_standing_foot_stays_flat_on_its_spot_and_no_foot_is_in_the_floor(model, name, side):
    place, rotation = soles(model, MOTIONS[name].states, side)
    stance = place[STANCE[side]]
    assert np.abs(stance - stance[0]).max() < 1e-3
    assert np.abs(stance[:, 2]).max() < 1e-3
    turned = (rotation[STANCE[side]] * rotation[STANCE[side].start].inv()).magnitude()
    assert np.degrees(turned.max()) < 1
    tilt = np.arccos(np.clip(rotation.as_matrix()[:, 2, 2], -1, 1))
    assert np.degrees(tilt.max()) < 1
    assert place[:, 2].min() > -1e-4
    assert place[:, 2].max() == pytest.approx(0.012, abs=2e-4)


@walks
def test_velocities_are_the_derivatives_of_positions(name):
    h, middle = 1e-4, DOUBLE / 2 + np.linspace(0.0013, 0.5987, 24)  # between the touchdowns
    before, now, after = (walk(ZEROTH01, GAITS[name], middle + shift) for shift in (-h, 0, h))
    for velocity, position in (
        ("base_linear_velocity", "base_position"),
        ("joint_velocity", "joint_position"),
    ):
        rate = (after[position] - before[position]) / (2 * h)
        np.testing.assert_allclose(now[velocity], rate, atol=2e-5)
    first, last = (
        Rotation.from_quat(s["base_orientation"][:, [1, 2, 3, 0]]) for s in (before, after)
    )
    rate = (first.inv() * last).as_rotvec() / (2 * h)  # in body axes
    np.testing.assert_allclose(now["base_angular_velocity"], rate, atol=1e-6)


@walks
def test_a_stride_closes_and_makes_good_the_speed_of_its_name(name):
    """``forward_0.10`` goes 0.06 m in 0.6 s, ``turn_left_1.0`` turns by 0.6 rad."""
    kind, _, number = name.rpartition("_")
    amount = float(number) * (-1 if kind in ("backward", "turn_right") else 1)
    speed, rate = (0, amount) if "turn" in kind else (amount, 0)
    ends = walk(ZEROTH01, GAITS[name], np.array([DOUBLE / 2, DOUBLE / 2 + 2 * STEP]))
    for key in ("joint_position", "joint_velocity", "base_angular_velocity"):
        np.testing.assert_allclose(ends[key][0], ends[key][1], atol=1e-9)
    turns = Rotation.from_quat(ends["base_orientation"][:, [1, 2, 3, 0]])
    turn = turns[0].inv() * turns[1]
    np.testing.assert_allclose(turn.as_rotvec(), [0, 0, 0.6 * rate], atol=1e-9)
    velocity = ends["base_linear_velocity"]
    np.testing.assert_allclose(turn.apply(velocity[0]), velocity[1], atol=1e-9)
    if rate == 0:
        way = ends["base_position"][1] - ends["base_position"][0]
        np.testing.assert_allclose(way, [0.6 * speed, 0, 0], atol=1e-9)
    heading = Rotation.from_quat(MOTIONS[name].states["base_orientation"][:, [1, 2, 3, 0]])
    forward = heading.inv().apply(MOTIONS[name].states["base_linear_velocity"])[:, 0]
    assert forward.mean() == pytest.approx(speed, abs=2e-3)


@pytest.mark.parametrize("name", MOTIONS)
def test_joints_keep_to_their_ranges_and_to_the_speed_of_the_servos(model, name):
    states = MOTIONS[name].states
    low, high = np.array([model.joint(joint).range for joint in ZEROTH01.joints]).T
    assert (states["joint_position"] > low + 0.2).all()
    assert (states["joint_position"] < high - 0.2).all()
    assert np.abs(states["joint_velocity"]).max() < 5.0  # the firmware's limit [rad/s]


@walks
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_robots_center_of_mass_is_the_pendulum_over_the_standing_foot(model, name, side):
    """Height, orbital energy and the capture point's way from the foot, as MuJoCo sees them."""
    states = MOTIONS[name].states
    com, speed = (np.array(part) for part in zip(
        *[(d.subtree_com[1].copy(), d.subtree_linvel[1].copy()) for d in poses(model, states)],
        strict=True,
    ))  # fmt: skip
    np.testing.assert_allclose(com[:, 2], 0.22, atol=1e-5)
    np.testing.assert_allclose(speed[:, 2], 0, atol=1e-5)
    part = SINGLE[side]
    foot = soles(model, states, side)[0][part]
    away, speed = (com[part] - foot)[:, :2], speed[part, :2]
    energy = (speed**2).sum(-1) - OMEGA**2 * (away**2).sum(-1)
    np.testing.assert_allclose(energy, energy[0], atol=2e-5)
    capture = away + speed / OMEGA
    growth = np.exp(OMEGA * (TIME[part] - TIME[part][0]))[:, None]
    np.testing.assert_allclose(capture, growth * capture[0], atol=2e-5)


@walks
def test_the_floor_can_bear_the_motion_on_the_soles_that_stand(model, name):
    """Zero-moment point of the whole robot, swinging leg included, from its change of momentum."""
    time = DOUBLE / 2 + np.arange(0.0, 2 * STEP, 0.004)
    x, y = np.array(ZEROTH01.sole_half_size) - 0.01  # 1 cm from the edge
    inner = [np.array([x, y, 0]), np.array([x, -y, 0]), np.array([-x, y, 0]), np.array([-x, -y, 0])]
    found = [
        (
            data.subtree_com[1].copy(),
            data.subtree_linvel[1].copy(),
            data.subtree_angmom[1].copy(),
            [
                (data.site(f"{s}_sole").xpos + data.site(f"{s}_sole").xmat.reshape(3, 3) @ corner)[:2]
                for s in ("left", "right")
                for corner in inner
            ],
            [data.site(f"{s}_sole").xpos[2] for s in ("left", "right")],
        )
        for data in poses(model, walk(ZEROTH01, GAITS[name], time))
    ]  # fmt: skip
    com, velocity, spin, corners, height = (np.array(part) for part in zip(*found, strict=True))
    acceleration = np.gradient(velocity, time, axis=0) - np.array([0, 0, -9.81])
    force = 3.3494 * acceleration
    torque = np.cross(com, force) + np.gradient(spin, time, axis=0)
    zmp = np.stack([-torque[:, 1], torque[:, 0]], -1) / force[:, 2:]
    for k in range(2, len(time) - 2):
        standing = np.repeat(height[k] < 1e-6, 4)
        assert Delaunay(corners[k][standing]).find_simplex(zmp[k]) >= 0, (time[k], zmp[k])


@pytest.mark.parametrize("name", MOTIONS)
def test_nothing_touches_but_feet_and_floor(model, name):
    for data in poses(model, MOTIONS[name].states):
        for contact in data.contact[: data.ncon]:
            names = {model.geom(geom).name for geom in contact.geom}
            assert names in ({"floor", "left_foot"}, {"floor", "right_foot"})


def test_arms_keep_the_standing_pose():
    arms = [j for j, name in enumerate(ZEROTH01.joints) if "shoulder" in name or "elbow" in name]
    for motion in MOTIONS.values():
        angles = motion.states["joint_position"][:, arms]
        np.testing.assert_allclose(angles, np.tile(angles[:1], (len(angles), 1)))
        np.testing.assert_allclose(angles[0], np.array(ZEROTH01.stand_position)[arms], atol=1e-7)


def test_states_of_a_walk_are_equally_spaced_over_a_stride():
    motion = MOTIONS["forward_0.10"]
    assert motion.period == pytest.approx(0.6)
    expected = walk(ZEROTH01, GAITS["forward_0.10"], TIME)["base_position"]
    np.testing.assert_allclose(motion.states["base_position"], expected, atol=1e-6)
    assert all(a < b for a, b in pairwise(expected[:, 0]))


def test_a_gait_beyond_the_reach_of_the_legs_is_refused():
    gait = replace(GAITS["forward_0.10"], speed=1.0)
    with pytest.raises(ValueError, match="gait must be within reach of the legs, got .*speed=1.0"):
        walk(ZEROTH01, gait, np.array([0.02, 0.28]))


def test_a_gait_that_would_bend_a_joint_too_far_is_refused():
    gait = replace(GAITS["forward_0.10"], lift=0.06)
    with pytest.raises(ValueError, match="gait must keep .*_knee_pitch in its range, got .*0.06"):
        walk(ZEROTH01, gait, np.array([0.02, 0.15, 0.28]))


def test_a_robot_without_a_file_of_motions_has_its_gaits_made():
    """Two of the gaits that ship, and one that its legs do not reach, which is left out."""
    few = {name: vars(GAITS[name]) for name in ("forward_0.10", "turn_left_0.5")}
    far = vars(replace(GAITS["forward_0.10"], speed=1.0))
    made = load_motions(replace(ZEROTH01, name="other", gaits=few | {"far": far}))
    assert list(made) == ["standing", "forward_0.10", "turn_left_0.5"]
    for name, motion in made.items():
        for key, values in motion.states.items():
            np.testing.assert_allclose(values, MOTIONS[name].states[key], atol=2e-6)


def test_gaits_of_another_size_have_the_same_froude_number():
    """Lengths as h, times as its root: v / sqrt(g h) and the steps' shares of h stay."""
    larger = replace(ZEROTH01, gaits={}, com_height=4 * ZEROTH01.com_height)
    found, own = gaits_of(larger)["forward_0.10"], GAITS["forward_0.10"]
    assert found.speed == pytest.approx(2 * own.speed)
    assert found.step_time == pytest.approx(2 * own.step_time)
    assert found.lift == pytest.approx(4 * own.lift)
