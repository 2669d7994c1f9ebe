"""The first-order lag."""

import math

import pytest
import torch
from torch.testing import assert_close

from zfall.envs.transforms.actions import LowPass


@pytest.mark.parametrize("control_dt", [0.04, 0.02, 0.004])
def test_step_response_is_the_exponential_at_any_control_rate(make_base, send, control_dt):
    base = make_base(num_envs=2, control_dt=control_dt)
    transform = LowPass(base, time_constant=0.05)
    got = send(transform, (base.stand_position + 1.0).expand(2, 80, 20)) - base.stand_position
    time = 0.004 * torch.arange(1, 81)
    expected = 1.0 - torch.exp(-time / 0.05)
    assert_close(got, expected[None, :, None].expand_as(got), atol=2e-6, rtol=0)


def test_any_command_is_filtered_as_by_the_recursion(make_base, send):
    base = make_base()
    commands = torch.randn(4, 50, 20)
    got = send(LowPass(base, time_constant=0.013), commands)
    level, gain = base.stand_position.expand(4, -1), 1.0 - math.exp(-0.004 / 0.013)
    for step in range(50):
        level = level + gain * (commands[:, step] - level)
        assert_close(got[:, step], level, atol=1e-5, rtol=0)
