"""What the robot is told."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.commands import Command

ACTION = {"action": (JointPositionTarget, {"scale": 1.0})}
RANGES = {"vx": [-0.1, 0.3], "yaw": [-1.0, 1.0]}


def test_command_is_zero_unless_told_otherwise(make_task):
    env = make_task({**ACTION, "command": (Command, {})})
    check_env_specs(env)
    td = env.reset()
    td["action"] = torch.zeros(4, 20)
    for there in (td, env.step(td)["next"]):
        assert torch.equal(there["command"], torch.zeros(4, 6))


def test_entries_are_uniform_in_their_ranges_and_the_rest_stays_zero(make_task):
    env = make_task({**ACTION, "command": (Command, {"ranges": RANGES})}, num_envs=2000)
    command = env.reset()["command"]
    vx, yaw = command[:, 0], command[:, 2]
    for value, (low, high) in ((vx, RANGES["vx"]), (yaw, RANGES["yaw"])):
        assert ((value >= low) & (value <= high)).all()
        assert value.mean().item() == pytest.approx((low + high) / 2, abs=0.03 * (high - low))
        assert value.std().item() == pytest.approx((high - low) / 12**0.5, rel=0.05)
    assert torch.corrcoef(torch.stack([vx, yaw]))[0, 1].abs() < 0.1
    assert not command[:, [1, 3, 4, 5]].any()


def changes(command: Command, steps: int) -> torch.Tensor:
    """Whether each world's command changes in each step ``(steps, N)``."""
    num = len(command.command)
    td = command._reset(TensorDict(batch_size=[num]), TensorDict(batch_size=[num]))
    seen = [td["command"]]
    for _ in range(steps):
        td = command._step(TensorDict(batch_size=[num]), TensorDict(batch_size=[num]))
        seen.append(td["command"])
    return (torch.stack(seen[1:]) != torch.stack(seen[:-1])).any(-1)


def test_fixed_interval_is_kept_to_the_step(make_base):
    """0.12 s at 0.04 s: in steps 3, 6, 9, ..."""
    command = Command(make_base(num_envs=5), ranges=RANGES, interval=[0.12, 0.12])
    found = changes(command, 12)
    expected = torch.arange(1, 13) % 3 == 0
    assert (found == expected[:, None]).all()


def test_times_between_changes_lie_in_the_interval(make_base):
    command = Command(make_base(num_envs=200), ranges=RANGES, interval=[0.2, 0.6])
    found = changes(command, 100)
    gaps = torch.cat([column.nonzero()[:, 0].diff() for column in found.unbind(1)]) * 0.04
    assert gaps.min() >= 0.2 - 1e-6
    assert gaps.max() <= 0.6 + 1e-6
    assert gaps.mean().item() == pytest.approx(0.4, abs=0.02)


def test_no_interval_keeps_the_command_for_the_episode(make_base):
    assert not changes(Command(make_base(), ranges=RANGES), 50).any()


def test_partial_reset_touches_its_rows_alone_and_draws_the_same_whoever_fell(make_task):
    commands = []
    for fallen in ([2], [0, 2]):
        env = make_task({**ACTION, "command": (Command, {"ranges": RANGES})}, num_envs=3)
        env.set_seed(1)
        td = env.reset()
        before = td["command"].clone()
        rows = torch.zeros(3, 1, dtype=torch.bool)
        rows[fallen] = True
        td["_reset"] = rows
        after = env.reset(td)["command"]
        changed = (after != before).any(-1)
        assert changed.nonzero()[:, 0].tolist() == fallen
        commands.append(after[2])
    assert torch.equal(*commands)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"ranges": {"speed": [0, 1]}}, "ranges must be of vx, vy, yaw, .* got 'speed'"),
        ({"ranges": {"vx": [1, 0]}}, r"ranges.vx must be \[smallest, largest\], got \[1, 0\]"),
        ({"interval": [0.01, 1.0]}, r"interval must be at least control_dt \(0.04\)"),
    ],
)
def test_bad_values_are_refused(make_base, values, message):
    with pytest.raises(ValueError, match=message):
        Command(make_base(), **values)


def test_a_commanded_rate_turns_the_commanded_heading_over_half_a_turn_and_back_to_0(make_base):
    """2 rad/s for 40 steps of 0.04 s are 3.2 rad, which is -2 pi + 3.2; a reset begins anew."""
    command = Command(make_base(num_envs=2), ranges={"yaw": [2.0, 2.0]}, turning=True)
    empty = TensorDict(batch_size=[2])
    td = command._reset(empty, TensorDict(batch_size=[2]))
    assert_close(td["commanded_heading"], torch.zeros(2, 1))
    for _ in range(40):
        td = command._step(empty, TensorDict(batch_size=[2]))
    expected = torch.full((2, 1), 3.2 - 2 * math.pi)
    assert_close(td["commanded_heading"], expected, atol=1e-5, rtol=0)
    one = TensorDict({"_reset": torch.tensor([[True], [False]])}, batch_size=[2])
    td = command._reset(one, TensorDict(batch_size=[2]))
    assert_close(td["commanded_heading"], expected * torch.tensor([[0.0], [1.0]]))


def test_given_commands_replace_the_draws_world_by_world(make_base):
    command = Command(make_base(num_envs=3), ranges=RANGES, interval=[0.04, 0.04])
    given = torch.arange(18.0).reshape(3, 6)
    command.give(given)
    empty = TensorDict(batch_size=[3])
    for td in (command._reset(empty, empty.clone()), command._step(empty, empty.clone())):
        assert_close(td["command"], given)
