"""How episodes begin."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.starts import NoisyStart, ScriptedStart

ACTION = {"action": (JointPositionTarget, {"scale": 1.0})}


def test_noise_has_its_deviations_around_the_standing_pose(make_task):
    values = {"joint_position": 0.05, "joint_velocity": 0.3}
    env = make_task({**ACTION, "start": (NoisyStart, values)}, num_envs=512)
    check_env_specs(env)
    td = env.reset()
    error = td["joint_position"] - env.base_env.stand_position
    assert error.std().item() == pytest.approx(0.05, rel=0.05)  # 10240 draws: 7 sigma
    assert td["joint_velocity"].std().item() == pytest.approx(0.3, rel=0.05)
    low, high = env.base_env.joint_range.unbind(-1)
    assert ((td["joint_position"] >= low) & (td["joint_position"] <= high)).all()


def test_partial_reset_draws_the_same_stream_whoever_fell(make_task):
    """Two envs of one seed; in one of them worlds 0 and 1 reset before world 2 does."""
    starts = []
    for fallen in ([2], [0, 1, 2]):
        env = make_task({**ACTION, "start": (NoisyStart, {"joint_position": 0.05})}, num_envs=3)
        env.set_seed(4)
        td = env.reset()
        rows = torch.zeros(3, 1, dtype=torch.bool)
        rows[fallen] = True
        td["_reset"] = rows
        starts.append(env.reset(td)["joint_position"][2])
    assert torch.equal(starts[0], starts[1])


def test_scripted_start_is_the_state_given(make_task):
    position = torch.rand(4, 20) * 0.1
    speed = torch.rand(4, 3)
    states = {"joint_position": position, "base_linear_velocity": speed}
    td = make_task({**ACTION, "start": (ScriptedStart, {"states": states})}).reset()
    assert_close(td["joint_position"], position)
    assert_close(td["base_linear_velocity"], speed)


def test_unknown_state_is_refused(make_base):
    with pytest.raises(ValueError, match=r"states must be of joint_position.*got base_speed"):
        ScriptedStart(make_base(), states={"base_speed": torch.zeros(4, 3)})


def test_negative_noise_is_refused(make_base):
    with pytest.raises(ValueError, match="joint_velocity must not be negative, got -1"):
        NoisyStart(make_base(), joint_velocity=-1)
