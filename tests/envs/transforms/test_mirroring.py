"""Falls to the left, seen and caught as those to the right are."""

import math

import mujoco
import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.robots import ZEROTH01
from zfall.envs.transforms.actions import JointPositionTarget, KneelReference
from zfall.envs.transforms.mirroring import MirroredFalls
from zfall.envs.transforms.modes import ModeMachine
from zfall.envs.transforms.observations import ObservationVector
from zfall.envs.transforms.starts import ScriptedStart

SEEN = ["projected_gravity", "base_angular_velocity", "joint_position", "com_velocity", "target"]
TABLE = {
    "action": (JointPositionTarget, {"scale": 0.6}),
    "kneel_reference": (KneelReference, {"landing": 0.6}),
    "mode": (ModeMachine, {"initial": "kneel"}),
}


def vector(env, **values):
    return ObservationVector(out_key="observation", measured=True, **values)


OBSERVATION = (vector, {"keys": SEEN})


MIRRORED = {"mirrored_falls": (MirroredFalls, {})}


def decide(transform, modes, velocities, facing=0.0):
    """Which worlds are mirrored after a step in these modes with these velocities [m/s]."""
    n = len(modes)
    turn = torch.tensor([math.cos(facing / 2), 0.0, 0.0, math.sin(facing / 2)])
    td = TensorDict(
        {
            "mode": torch.eye(3)[modes],
            "base_orientation": turn.expand(n, -1),
            "com_velocity": torch.tensor([[x, y, 0.0] for x, y in velocities]),
        },
        batch_size=[n],
    )
    return transform._call(td)["mirrored"][:, 0].tolist()


def test_the_side_is_that_of_the_step_that_leaves_recover(make_base):
    """RECOVER is never mirrored; what was decided holds in KNEEL and STABLE, and ends with it."""
    transform = MirroredFalls(make_base(num_envs=3))
    left, right = (0.1, 0.5), (0.1, -0.5)
    assert decide(transform, [0, 0, 1], [left, left, left]) == [False, False, True]
    assert decide(transform, [1, 1, 1], [left, right, right]) == [True, False, True]
    assert decide(transform, [1, 1, 2], [right, left, right]) == [True, False, True]
    assert decide(transform, [0, 0, 0], [left, left, left]) == [False, False, False]
    assert decide(transform, [1, 1, 1], [right, left, left]) == [False, True, True]


@pytest.mark.parametrize("facing", [0.0, 2.0, -2.0])
def test_left_is_left_of_the_robot_s_own_heading(make_base, facing):
    transform = MirroredFalls(make_base(num_envs=2))
    ways = [(math.cos(facing + angle), math.sin(facing + angle)) for angle in (0.3, -0.3)]
    assert decide(transform, [1, 1], ways, facing) == [True, False]


def test_worlds_that_go_on_keep_their_side(make_base):
    transform = MirroredFalls(make_base(num_envs=3))
    assert decide(transform, [1, 1, 1], [(0.0, 0.5)] * 3) == [True] * 3
    reset = TensorDict({"_reset": torch.tensor([[False], [True], [True]])}, [3])
    new = TensorDict(  # rows that are not reset hold nothing of use
        {
            "mode": torch.eye(3)[[0, 1, 0]],
            "base_orientation": torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(3, -1),
            "com_velocity": torch.tensor([[0.0, -0.5, 0.0]]).expand(3, -1),
        },
        batch_size=[3],
    )
    assert transform._reset(reset, new)["mirrored"][:, 0].tolist() == [True, False, False]
    ways = [(0.0, -0.5), (0.0, 0.5), (0.0, 0.5)]
    assert decide(transform, [1, 1, 1], ways) == [True, False, True]


def other_side(name: str) -> str:
    return name.replace("left", "*").replace("right", "left").replace("*", "right")


def image(joints: torch.Tensor) -> torch.Tensor:
    """Angles of the robot in the mirror, joint by joint, by name."""
    names, out = ZEROTH01.joints, torch.empty_like(joints)
    for k, name in enumerate(names):
        out[..., names.index(other_side(name))] = ZEROTH01.mirror_sign[k] * joints[..., k]
    return out


def test_a_policy_acts_in_a_fall_to_the_left_as_the_mirror_image_of_one_to_the_right(make_task):
    """Two worlds, one the other's image, and a policy of random weights: so are its targets.

    The centers of mass of its limbs are then where those of the other are, but for the sign of y.
    """
    joints = 0.1 * torch.rand(20)
    lean, side = math.sin(0.1), torch.tensor([1.0, -1.0])[:, None]
    start = {
        "joint_position": torch.stack([joints, image(joints)]),
        "joint_velocity": torch.zeros(2, 20),
        "base_position": torch.tensor([[0.0, 0.0, 0.5]]).expand(2, -1),
        "base_orientation": torch.cat(
            [torch.full((2, 1), math.cos(0.1)), lean * side, torch.zeros(2, 2)], 1
        ),
        "base_linear_velocity": torch.cat(
            [torch.full((2, 1), 0.4), -0.9 * side, torch.zeros(2, 1)], 1
        ),
        "base_angular_velocity": torch.cat([side, torch.full((2, 1), 2.0), 0.5 * side], 1),
    }
    begin = {"start": (ScriptedStart, {"states": start})}
    env = make_task(begin | TABLE | {"observation": OBSERVATION} | MIRRORED, num_envs=2)
    check_env_specs(env)
    td = env.reset()
    assert td["mirrored"][:, 0].tolist() == [False, True]
    assert_close(td["observation"][1], td["observation"][0], rtol=0, atol=0.02)  # rounded robot
    policy = torch.nn.Linear(td["observation"].shape[1], 20)
    with torch.no_grad():
        td["action"] = 2.0 * policy(td["observation"][:1]).expand(2, -1)
        after = env.step(td)["next"]
    low, high = env.base_env.joint_range.unbind(-1)
    right, left = after["target"]
    assert (right - env.base_env.stand_position).abs().max() > 0.1
    assert_close(left, image(right).clamp(low, high), rtol=0, atol=1e-5)
    model = env.base_env.simulation.model
    data = [mujoco.MjData(model), mujoco.MjData(model)]
    for d, targets in zip(data, (right, left), strict=True):
        for name, angle in zip(ZEROTH01.joints, targets, strict=True):
            d.joint(name).qpos[0] = angle
        mujoco.mj_kinematics(model, d)
    for name in ZEROTH01.joints:
        x, y, z = data[0].xipos[model.joint(name).bodyid[0]]
        there = data[1].xipos[model.joint(other_side(name)).bodyid[0]]
        assert there == pytest.approx([x, -y, z], abs=0.012), name  # two small parts differ


def test_it_comes_after_what_it_reflects(make_task):
    with pytest.raises(ValueError, match="must come after transforms.observation"):
        make_task(TABLE | MIRRORED | {"observation": OBSERVATION}, num_envs=1)
