"""Each term against MuJoCo's own state, or by hand."""

import math

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.transforms.foreign.terms import (
    TERMS,
    BaseAngularVelocity,
    BaseLinearVelocity,
    Command,
    EpisodeTime,
    GaitClock,
    JointPosition,
    JointVelocity,
    PreviousAction,
    ProjectedGravity,
    Quantity,
    Seen,
)
from zfall.robots import ZEROTH01
from zfall.simulation.model import base_center_of_mass

JOINTS = ["left_knee_pitch", "right_hip_pitch", "left_ankle_roll"]
TURN = np.array([0.8, 0.2, -0.4, 0.4])  # of length 1


def matrix(quaternion=TURN) -> np.ndarray:
    """Base to world, by MuJoCo."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)


@pytest.fixture
def seen():
    """One world, in its third control step of 20 ms."""
    joints = len(ZEROTH01.joints)
    td = {
        "base_orientation": torch.tensor(TURN).float()[None],
        "base_linear_velocity": torch.tensor([[0.3, -0.2, 0.1]]),
        "base_angular_velocity": torch.tensor([[1.0, 2.0, -0.5]]),
        "projected_gravity": torch.tensor([[0.6, 0.0, -0.8]]),
        "joint_position": torch.arange(joints)[None] / 10,
        "joint_velocity": torch.arange(joints)[None] / 5,
        "feet_contact": torch.tensor([[True, False]]),
    }
    return Seen(
        TensorDict(td, [1]),
        ZEROTH01,
        torch.tensor([ZEROTH01.joints.index(name) for name in JOINTS]),
        torch.full((joints,), 0.05),
        torch.tensor([0.01, -0.02, 0.03]),
        torch.tensor([[2]]),
        0.02,
        torch.tensor([[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]]),
    )


def test_the_velocity_of_the_base_is_in_its_own_axes(seen):
    expected = matrix().T @ [0.3, -0.2, 0.1]
    assert_close(BaseLinearVelocity()(seen)[0].double().numpy(), expected, atol=1e-6, rtol=0)
    assert_close(BaseLinearVelocity(frame="world")(seen), torch.tensor([[0.3, -0.2, 0.1]]))


def test_the_center_of_mass_of_the_base_moves_as_mujoco_says(make_base):
    base = make_base(num_envs=1)
    model = base.simulation.model
    root = model.jnt_bodyid[0]
    model.body_ipos[root] = [0.01, -0.02, 0.03]  # the robot's own is its origin
    model.body_sameframe[root] = 0
    data = mujoco.MjData(model)
    data.qpos[3:7] = TURN
    data.qvel[:6] = [0.3, -0.2, 0.1, 1.0, 2.0, -0.5]
    mujoco.mj_forward(model, data)
    velocity = np.zeros(6)  # of the center of mass, in the axes of the link
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, root, velocity, 0)
    moved = matrix().T @ velocity[3:]
    at = (data.qpos[3:7], data.qvel[:3], data.qvel[3:6])
    keys = ("base_orientation", "base_linear_velocity", "base_angular_velocity")
    td = {key: torch.tensor(value).float()[None] for key, value in zip(keys, at, strict=True)}
    center = base_center_of_mass(model)
    fixed = (torch.zeros(0), torch.zeros(20), center, torch.zeros(1, 1), 0.02, torch.zeros(1, 2, 0))
    seen = Seen(TensorDict(td, [1]), base.robot, *fixed)
    found = BaseLinearVelocity(point="center_of_mass")(seen)[0].double().numpy()
    assert_close(found, moved, atol=1e-6, rtol=0)


def test_the_angular_velocity_is_that_of_a_gyro_unless_other_axes_are_wanted(seen):
    spin = np.array([1.0, 2.0, -0.5])
    for frame, expected in (
        ("base", spin),
        ("world", matrix() @ spin),
        ("base_turned_back", matrix().T @ spin),
    ):
        found = BaseAngularVelocity(frame=frame)(seen)[0].double().numpy()
        assert_close(found, expected, atol=1e-6, rtol=0)


def test_gravity_is_a_direction(seen):
    assert ProjectedGravity()(seen)[0].tolist() == pytest.approx([0.6, 0.0, -0.8])


def test_a_command_stays(seen):
    assert Command(value=[0.1, 0.0, -0.2])(seen)[0].tolist() == pytest.approx([0.1, 0.0, -0.2])


def test_joints_stand_in_the_order_of_their_names(seen):
    places = [ZEROTH01.joints.index(name) for name in JOINTS]
    angles = [place / 10 for place in places]
    assert JointPosition(relative=False)(seen)[0].tolist() == pytest.approx(angles)
    relative = [angle - 0.05 for angle in angles]
    assert JointPosition()(seen)[0].tolist() == pytest.approx(relative)
    assert JointVelocity()(seen)[0].tolist() == pytest.approx([place / 5 for place in places])
    own = JointVelocity(joints=["left_hip_yaw"])(seen)[0].tolist()
    assert own == pytest.approx([ZEROTH01.joints.index("left_hip_yaw") / 5])


def test_the_action_is_that_of_one_or_two_steps_ago(seen):
    assert PreviousAction()(seen).tolist() == [[1.0, 2.0, 3.0]]
    assert PreviousAction(steps=2)(seen).tolist() == [[4.0, 5.0, 6.0]]


def test_a_gait_clock_gives_each_function_of_all_feet(seen):
    phase = 2 * math.pi * 1.5 * 0.04  # two steps of 20 ms
    cos, sin = math.cos(phase), math.sin(phase)
    found = GaitClock(frequency=1.5)(seen)[0].tolist()
    assert found == pytest.approx([cos, -cos, sin, -sin], abs=1e-6)
    one = GaitClock(frequency=1.5, offsets=[0.0], functions=["sin", "cos"])(seen)[0].tolist()
    assert one == pytest.approx([sin, cos], abs=1e-6)


def test_the_clock_of_playground_lags_a_step_and_stops_for_a_command_to_stand(seen):
    clock = GaitClock(frequency=1.5, late=1, standing=math.pi)
    found = []
    for step in range(3):
        object.__setattr__(seen, "steps", torch.tensor([[step]]))
        found.append(clock(seen)[0].tolist())
    # Of ``reset``, of the first ``step``, which moves the phase after its observation, the next.
    assert found[0] == pytest.approx([1, -1, 0, 0], abs=1e-6)
    assert found[1] == pytest.approx([1, -1, 0, 0], abs=1e-6)
    assert found[2] == pytest.approx([-1, -1, 0, 0], abs=1e-6)


def test_the_time_of_an_episode_is_in_seconds(seen):
    assert EpisodeTime()(seen)[0].tolist() == pytest.approx([0.04])
    assert EpisodeTime(before=1.0)(seen)[0].tolist() == pytest.approx([1.04])


def test_any_quantity_of_ours_is_a_term(seen):
    assert Quantity(name="feet_contact")(seen).tolist() == [[1.0, 0.0]]


def test_a_term_reads_what_was_measured(seen):
    seen.tensordict["measured", "projected_gravity"] = torch.tensor([[0.0, 1.0, 0.0]])
    assert ProjectedGravity()(seen).tolist() == [[0.0, 1.0, 0.0]]


def test_each_name_of_a_term_is_that_of_its_class():
    for name, term in TERMS.items():
        assert term.__name__ == "".join(word.capitalize() for word in name.split("_"))
