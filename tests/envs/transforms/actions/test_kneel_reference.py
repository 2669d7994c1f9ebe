"""The reference of the targets goes from standing to the kneel once it is to kneel."""

import dataclasses

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.robots import ZEROTH01
from zfall.envs.transforms.actions import KneelReference

KNEE = ZEROTH01.joints.index("right_knee_pitch")  # farthest from the kneel: 1.33 rad away


def step(reference: KneelReference, mode: list[int], target: torch.Tensor) -> torch.Tensor:
    modes = torch.nn.functional.one_hot(torch.tensor(mode), 3).float()
    td = TensorDict({"mode": modes, "target": target}, batch_size=[len(mode)])
    return reference._inv_call(td)["target"]


def test_targets_stand_in_recover_and_go_to_the_kneel_at_the_speed(make_base):
    """World 1 begins to kneel: after k steps a joint has gone k * 4 rad/s * 0.04 s, to its end."""
    env = make_base(num_envs=2, control_dt=0.04)
    reference = KneelReference(env, speed=4.0)
    stand = env.stand_position.expand(2, -1)
    kneel = torch.tensor(ZEROTH01.kneel_position)
    away = kneel - stand[0]
    for k in range(1, 13):
        out = step(reference, [0, 1], stand)
        assert torch.equal(out[0], stand[0])
        gone = away.sign() * away.abs().clamp_max(0.16 * k)
        assert_close(out[1], stand[1] + gone)
    assert_close(out[1], kneel)
    assert_close(step(reference, [1, 2], stand)[1], kneel)  # STABLE stays there
    assert_close(step(reference, [0, 0], stand), stand)  # back


def test_a_policy_corrects_the_script_within_the_joint_ranges(make_base):
    env = make_base(num_envs=2, control_dt=0.04)
    reference = KneelReference(env, speed=1000.0)
    correction = torch.zeros(2, 20)
    correction[0, KNEE], correction[1, KNEE] = 0.3, -9.0
    out = step(reference, [1, 1], env.stand_position + correction)
    assert_close(out[0, KNEE], torch.tensor(ZEROTH01.kneel_position)[KNEE] + 0.3)
    assert_close(out[1, KNEE], env.joint_range[KNEE, 0])


def test_a_reset_begins_from_standing_in_its_rows_alone(make_base):
    env = make_base(num_envs=2)
    reference = KneelReference(env)
    stand = env.stand_position.expand(2, -1)
    step(reference, [1, 1], stand)
    before = reference.way.clone()
    rows = TensorDict({"_reset": torch.tensor([[False], [True]])}, batch_size=[2])
    reference._reset(rows, TensorDict(batch_size=[2]))
    assert torch.equal(reference.way[0], before[0])
    assert torch.equal(reference.way[1], stand[1])


def test_bad_values_are_refused(make_base):
    with pytest.raises(ValueError, match="speed must be positive, got 0"):
        KneelReference(make_base(), speed=0.0)
    robot = dataclasses.replace(ZEROTH01, kneel={})
    env = HumanoidEnv(num_envs=1, robot=robot, control_dt=0.04, physics_dt=0.004)
    with pytest.raises(ValueError, match="needs a robot with a kneel"):
        KneelReference(env)
