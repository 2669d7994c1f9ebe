"""Balance terms by hand."""

import math

import pytest
import torch
from tensordict import TensorDict

from zfall.envs.terms.balance import base_speed, capture_point

NONE = TensorDict(batch_size=[1])


def test_base_speed_ignores_the_vertical_and_is_1_over_e_at_sigma():
    td = TensorDict({"base_linear_velocity": torch.tensor([[0.3, 0.4, 9.0]])}, batch_size=[1])
    assert base_speed(NONE, td, sigma=0.5).item() == pytest.approx(math.exp(-1), rel=1e-6)


def test_capture_point_is_1_when_the_pendulum_comes_to_rest_over_the_feet():
    """x = -v sqrt(z / g): a pendulum 0.22 m high at -0.0749 m with 0.5 m/s stops at the feet."""
    time = math.sqrt(0.22 / 9.81)
    td = TensorDict(
        {
            "com_position": torch.tensor([[1.0 - 0.5 * time, 2.0, 0.22]]),
            "com_velocity": torch.tensor([[0.5, 0.0, 0.0]]),
            "feet_position": torch.tensor([[[1.0, 2.1, 0.0], [1.0, 1.9, 0.0]]]),
        },
        batch_size=[1],
    )
    assert capture_point(NONE, td, sigma=0.1).item() == pytest.approx(1.0, abs=1e-6)
    td["com_position"][:, 1] += 0.1
    assert capture_point(NONE, td, sigma=0.1).item() == pytest.approx(math.exp(-1), rel=1e-5)
