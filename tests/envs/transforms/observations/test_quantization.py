"""Resolution."""

import math

import pytest
import torch
from torch.testing import assert_close

from zfall.envs.transforms.observations import Quantization


def test_error_is_half_a_step_at_most_and_values_lie_on_the_grid(measure):
    step = 2 * math.pi / 4096
    true = torch.rand(64, 20) * 6 - 3
    got = measure(Quantization(step={"joint_position": step}), joint_position=true)
    error = (got - true).abs()
    assert error.max() <= step / 2 + 1e-6
    assert error.max() > 0.49 * step
    counts = got.double() / step
    assert_close(counts, counts.round(), atol=1e-3, rtol=0)


def test_it_rounds_at_a_reset_too(measure):
    rounding = Quantization(step={"joint_position": 0.5})
    got = measure(rounding, reset=True, joint_position=torch.tensor([[0.3, -0.6, 1.2]]))
    assert_close(got, torch.tensor([[0.5, -0.5, 1.0]]))


def test_step_must_be_positive():
    with pytest.raises(ValueError, match=r"step.joint_position must be positive, got 0"):
        Quantization(step={"joint_position": 0})
