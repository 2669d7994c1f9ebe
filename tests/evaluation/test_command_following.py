"""Robots that move by formula, and what is said of how they follow commands."""

import math
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from tests.evaluation.moments import ended, moment
from zfall.evaluation.command_following import CommandFollowing

ENV = SimpleNamespace(num_envs=2, control_dt=0.1)


def step(angle: float, speed: float, command: list[float], wanted: float | None) -> TensorDict:
    """Two robots with this heading [rad] and speed along it; the second one slips to the left."""
    half = torch.full((2,), 0.5 * angle)
    turn = torch.stack([half.cos(), 0 * half, 0 * half, half.sin()], -1)
    ahead = torch.tensor([math.cos(angle), math.sin(angle), 0.0])
    left = torch.tensor([-math.sin(angle), math.cos(angle), 0.0])
    velocity = torch.stack([speed * ahead, speed * ahead + 0.05 * left])
    values = {
        "base_orientation": turn,
        "base_linear_velocity": velocity,
        "command": torch.tensor([command]).expand(2, 6).clone(),
    }
    if wanted is not None:
        values["commanded_heading"] = torch.full((2, 1), wanted)
    return TensorDict(values, [2])


def test_a_robot_on_a_circle_is_as_far_off_as_its_speeds_are():
    """It walks 0.3 of 0.2 m/s and turns 0.5 of 0.4 rad/s for 20 s: 2 rad too far, over a turn."""
    follower = CommandFollowing(ENV)
    for k in range(1, 201):
        wrapped = math.remainder(0.04 * k, 2 * math.pi)
        td = step(0.05 * k, 0.3, [0.2, 0.0, 0.4, 0, 0, 0], wrapped)
        since = 0.1 * k - 2.0
        now = moment([True, True], since)
        follower.update(td, now) if since > 0 else follower.before(td, now)
    table = {name: value.tolist() for name, value in follower.table(ended([False] * 2)).items()}
    assert table["velocity_forward"] == pytest.approx([0.3, 0.3], abs=1e-5)
    assert table["velocity_left"] == pytest.approx([0.0, 0.05], abs=1e-5)
    assert table["velocity_error"] == pytest.approx([0.1, math.hypot(0.1, 0.05)], abs=1e-5)
    assert table["yaw_rate"] == pytest.approx([0.5, 0.5], abs=1e-4)
    assert table["yaw_rate_error"] == pytest.approx([0.1, 0.1], abs=1e-4)
    assert table["heading_error"] == pytest.approx([2.0, 2.0], abs=1e-3)


def test_what_follows_a_fall_does_not_count_and_a_command_may_be_a_heading():
    """The second robot falls after one step; heading 0.3 is commanded, 0.1 rad a step are made."""
    follower = CommandFollowing(ENV)
    for k in (1, 2, 3):
        td = step(0.1 * k, 0.3 * k, [0.0, 0.0, 0.3, 0, 0, 0], None)
        follower.update(td, moment([True, k == 1], 0.1 * k))
    table = follower.table(ended([False, True]))
    assert table["velocity_forward"].tolist() == pytest.approx([0.6, 0.3], abs=1e-5)
    assert table["heading_error"].tolist() == pytest.approx([0.0, 0.2], abs=1e-5)


def test_a_trial_that_was_over_before_has_no_figures():
    follower = CommandFollowing(ENV)
    follower.before(step(0.1, 0.1, [0.0] * 6, 0.0), moment([True, True], -0.1))
    table = follower.table(ended([True, True], [True, True]))
    assert all(value.isnan().all() for value in table.values())
