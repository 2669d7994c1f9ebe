"""Loops worked out by hand."""

import torch
from torch.testing import assert_close

from zfall.envs.transforms.actions import Backlash, Deadband


def loop(base, send, transform, ways: list[float]) -> torch.Tensor:
    """Response of one joint to a course of commands, both as ways from the reference."""
    start = base.stand_position
    commands = start + torch.tensor(ways)[None, :, None].expand(1, -1, 20)
    got = send(transform, commands) - start
    assert_close(got, got[..., :1].expand_as(got), atol=1e-6, rtol=0)
    return got[0, :, 15]


def test_backlash_takes_up_the_play_at_every_turn(make_base, send):
    base = make_base(num_envs=1, control_dt=0.02)
    # Play 0.2: it follows 0.1 behind, and stands still for 0.2 after a turn.
    course = [0.0, 0.1, 0.2, 0.5, 0.4, 0.3, 0.2, 0.0, -0.5, -0.4, -0.3, -0.2, 0.0, 0.05, 0.3]
    expected = [0.0, 0.0, 0.1, 0.4, 0.4, 0.4, 0.3, 0.1, -0.4, -0.4, -0.4, -0.3, -0.1, -0.05, 0.2]
    got = loop(base, send, Backlash(base, width=0.2), course)
    assert_close(got, torch.tensor(expected), atol=1e-6, rtol=0)


def test_deadband_ignores_small_changes_until_they_add_up(make_base, send):
    base = make_base(num_envs=1, control_dt=0.02)
    course = [0.05, 0.09, 0.11, 0.15, 0.2, 0.22, 0.13, 0.11, 0.5, 0.41, 0.39, 0.3, 0.28, 0.28, 0.28]
    expected = [
        0.0,
        0.0,
        0.11,
        0.11,
        0.11,
        0.22,
        0.22,
        0.11,
        0.5,
        0.5,
        0.39,
        0.39,
        0.28,
        0.28,
        0.28,
    ]
    got = loop(base, send, Deadband(base, width=0.1), course)
    assert_close(got, torch.tensor(expected), atol=1e-6, rtol=0)


def test_without_width_the_command_passes(make_base, send):
    base = make_base(num_envs=2)
    commands = torch.randn(2, 20, 20)
    for cls in (Backlash, Deadband):
        assert torch.equal(send(cls(base, width=0.0), commands), commands)
