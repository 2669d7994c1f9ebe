"""Falls to the left, seen and caught as those to the right are."""

import math

import mujoco
import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs, step_mdp

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import CAPSNeighbours, NormalizedVector, ObservationVector
from zfall.envs.transforms.starts import ScriptedStart
from zfall.envs.transforms.windows import LastAction
from zfall.falling.kneel_reference import KneelReference
from zfall.falling.mirrored_falls import MirroredFalls
from zfall.falling.modes import ModeMachine
from zfall.robots import ZEROTH01
from zfall.rotations import turned

SEEN = ["projected_gravity", "base_angular_velocity", "joint_position", "com_velocity", "target"]
KNOWN = [*SEEN, "joint_velocity", "base_position", "feet_position", "base_linear_velocity"]


def vector(env, **values):
    return ObservationVector(out_key="observation", measured=True, **values)


ACTION = {
    "action": (JointPositionTarget, {"scale": 0.6}),
    "kneel_reference": (KneelReference, {"landing": 0.6}),
}
MODE = {"mode": (ModeMachine, {"initial": "kneel"})}
OBSERVATION = {"observation": (vector, {"keys": SEEN})}
MIRRORED = {"mirrored_falls": (MirroredFalls, {})}


def worlds(modes, velocities, facing=0.0):
    """Worlds in these modes with these velocities of the center of mass [m/s]."""
    turn = torch.tensor([math.cos(facing / 2), 0.0, 0.0, math.sin(facing / 2)])
    return TensorDict(
        {
            "mode": torch.eye(3)[modes],
            "base_orientation": turn.expand(len(modes), -1),
            "com_velocity": torch.tensor([[x, y, 0.0] for x, y in velocities]),
        },
        batch_size=[len(modes)],
    )


def test_the_side_is_that_of_the_step_that_leaves_recover(make_base):
    """RECOVER is never mirrored; what was decided holds in KNEEL and STABLE, and ends with it."""
    transform = MirroredFalls(make_base(num_envs=3))
    left, right = (0.1, 0.5), (0.1, -0.5)
    td = transform._reset(TensorDict(batch_size=[3]), worlds([0, 0, 1], [left] * 3))
    seen = [td["fall_mirrored"][:, 0].tolist()]
    for modes, ways in (
        ([1, 1, 1], [left, right, right]),
        ([1, 1, 2], [right, left, right]),
        ([0, 0, 0], [left, left, left]),
        ([1, 1, 1], [right, left, left]),
    ):
        td = transform._step(td, worlds(modes, ways))
        seen.append(td["fall_mirrored"][:, 0].tolist())
    assert seen == [
        [False, False, True],
        [True, False, True],
        [True, False, True],
        [False, False, False],
        [False, True, True],
    ]


@pytest.mark.parametrize("facing", [0.0, 2.0, -2.0])
def test_left_is_left_of_the_robot_s_own_heading(make_base, facing):
    transform = MirroredFalls(make_base(num_envs=2))
    ways = [(math.cos(facing + angle), math.sin(facing + angle)) for angle in (0.3, -0.3)]
    td = transform._reset(TensorDict(batch_size=[2]), worlds([1, 1], ways, facing))
    assert td["fall_mirrored"][:, 0].tolist() == [True, False]


def other_side(name: str) -> str:
    return name.replace("left", "*").replace("right", "left").replace("*", "right")


def image(joints: torch.Tensor) -> torch.Tensor:
    """Angles of the robot in the mirror, joint by joint, by name."""
    names, out = ZEROTH01.joints, torch.empty_like(joints)
    for k, name in enumerate(names):
        out[..., names.index(other_side(name))] = ZEROTH01.mirror_sign[k] * joints[..., k]
    return out


@pytest.fixture
def pair(make_task):
    """Two worlds in the air, facing 0.7 rad to the left and the right, one the other's image."""
    joints, side = 0.1 * torch.rand(20), torch.tensor([1.0, -1.0])[:, None]
    lean = torch.cat(
        [torch.full((2, 1), math.cos(0.1)), math.sin(0.1) * side, torch.zeros(2, 2)], 1
    )
    start = {
        "joint_position": torch.stack([joints, image(joints)]),
        "joint_velocity": torch.zeros(2, 20),
        "base_position": torch.tensor([[0.1, 0.2, 1.5], [0.1, -0.2, 1.5]]),
        "base_orientation": turned(lean, 0.7 * side[:, 0]),
        "base_linear_velocity": torch.tensor([[0.4, -0.9, 0.0], [0.4, 0.9, 0.0]]),
        "base_angular_velocity": torch.cat([side, torch.full((2, 1), 2.0), 0.5 * side], 1),
    }
    ranges = {"joint_position": "joint_range", "base_position": [0.0, 2.0]}
    critic = {"keys": KNOWN, "ranges": ranges, "out_key": "observation_critic"}
    table = {"start": (ScriptedStart, {"states": start})} | ACTION | MODE | OBSERVATION
    return make_task(table | {"critic": (NormalizedVector, critic)} | MIRRORED, num_envs=2)


def test_a_fall_to_the_left_is_seen_and_caught_as_the_mirror_image_of_one_to_the_right(pair):
    """A policy of random weights: observations stay alike, and so targets the image of targets.

    The centers of mass of its limbs are then where those of the other are, but for the sign of y.
    """
    check_env_specs(pair)
    torch.manual_seed(0)
    td = pair.reset()
    policy = torch.nn.Linear(td["observation"].shape[1], 20)
    low, high = pair.base_env.joint_range.unbind(-1)
    for _ in range(5):
        assert td["fall_mirrored"][:, 0].tolist() == [False, True]
        for key in ("observation", "observation_critic"):
            assert_close(td[key][1], td[key][0], rtol=0.05, atol=0.1)  # small parts differ
        with torch.no_grad():
            td["action"] = policy(td["observation"][:1]).clamp(-0.5, 0.5).expand(2, -1)
        td = step_mdp(pair.step(td))
        right, left = td["target"]
        assert_close(left, image(right).clamp(low, high), rtol=0, atol=1e-5)
    assert (right - pair.base_env.stand_position).abs().max() > 0.3
    model = pair.base_env.simulation.model
    data = [mujoco.MjData(model), mujoco.MjData(model)]
    for d, targets in zip(data, (right, left), strict=True):
        for name, angle in zip(ZEROTH01.joints, targets, strict=True):
            d.joint(name).qpos[0] = angle
        mujoco.mj_kinematics(model, d)
    for name in ZEROTH01.joints:
        x, y, z = data[0].xipos[model.joint(name).bodyid[0]]
        there = data[1].xipos[model.joint(other_side(name)).bodyid[0]]
        assert there == pytest.approx([x, -y, z], abs=0.012), name  # two small parts differ


def test_a_partial_reset_leaves_what_others_see(pair):
    td = pair.reset()
    td["action"] = torch.zeros(2, 20)
    td = step_mdp(pair.step(td))
    before = td.clone()
    td["_reset"] = torch.tensor([[True], [False]])
    after = pair.reset(td)
    for key in ("observation", "observation_critic", "fall_mirrored"):
        assert torch.equal(after[key][1], before[key][1])
    assert not torch.equal(after["observation"][0], before["observation"][0])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (ACTION | MODE | MIRRORED | OBSERVATION, "mirrored_falls .* observation"),
        (MODE | OBSERVATION | MIRRORED, "mirrored_falls .* KneelReference"),
        (ACTION | OBSERVATION | MIRRORED, "the key mode"),
        (
            ACTION | MODE | OBSERVATION | {"near": (CAPSNeighbours, {"sigma": 0.1})} | MIRRORED,
            "mirrored_falls .* near",
        ),
        (
            ACTION
            | MODE
            | {"last": (lambda env: LastAction(), {})}
            | {"observation": (vector, {"keys": ["last_action"]})}
            | MIRRORED,
            "observation.keys .* last_action",
        ),
    ],
)
def test_what_does_not_fit_is_refused(make_task, table, message):
    with pytest.raises(ValueError, match=message):
        make_task(table, num_envs=1)
