"""Balance terms by hand."""

import math

import pytest
import torch
from tensordict import TensorDict

from zfall.envs.terms.balance import (
    base_speed,
    capture_point,
    centroidal_momentum,
    com_velocity_to_support,
    vertical_com_speed,
)
from zfall.robots import ZEROTH01

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


def standing(com: list[float], velocity: list[float], contact: list[bool]) -> TensorDict:
    """Feet level at y = 0.1 and -0.1: the middle of the support is the origin."""
    feet = [[[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]]
    values = {
        "com_position": torch.tensor([com]),
        "com_velocity": torch.tensor([velocity]),
        "feet_position": torch.tensor(feet),
        "feet_orientation": torch.tensor([[[1.0, 0, 0, 0]] * 2]),
        "feet_corner_force": torch.ones(1, 2, 4),
        "feet_contact": torch.tensor([contact]),
    }
    return TensorDict(values, batch_size=[1])


def test_velocity_to_the_support_is_right_at_omega_times_the_distance():
    """0.02 m in front of the middle at 0.25 m: sqrt(9.81 / 0.25) 0.02 = 0.1253 m/s back."""
    speed = 0.02 * math.sqrt(9.81 / 0.25)
    values = {"robot": ZEROTH01, "cutoff": 0.1, "epsilon": 0.01}
    right = standing([0.02, 0.0, 0.25], [-speed, 0.0, 0.7], [True, True])
    assert com_velocity_to_support(NONE, right, **values).item() == pytest.approx(1.0, abs=1e-4)
    off = standing([0.02, 0.0, 0.25], [-speed, 0.1, 0.0], [True, True])
    assert com_velocity_to_support(NONE, off, **values).item() == pytest.approx(0.01, abs=1e-4)
    air = standing([0.02, 0.0, 0.25], [-speed, 0.0, 0.0], [True, False])
    assert com_velocity_to_support(NONE, air, **values).item() == 0.0


def test_vertical_speed_ignores_the_level_one():
    td = standing([0.0, 0.0, 0.2], [3.0, -2.0, -0.64], [True, True])
    assert vertical_com_speed(NONE, td, cutoff=0.64, epsilon=0.01).item() == pytest.approx(0.01)


def test_momentum_adds_its_two_shares():
    """|p| = 5 of 10 and |L| = 0.6 of 1.2: half and half, at the cutoff."""
    p, turning = torch.tensor([[3.0, 0.0, 4.0]]), torch.tensor([[0.0, 0.6, 0.0]])
    td = TensorDict({"linear_momentum": p, "angular_momentum": turning}, batch_size=[1])
    value = centroidal_momentum(NONE, td, linear=10.0, angular=1.2, epsilon=0.05)
    assert value.item() == pytest.approx(0.05, rel=1e-4)
