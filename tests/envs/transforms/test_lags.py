"""Delays in physics steps."""

import pytest
import torch

from zfall.envs.transforms.lags import Lags


def lags(delay=(0.0, 0.02), **values) -> Lags:
    given = {"max_delay": 0.1, "per": "episode", "physics_dt": 0.004, "rng": torch.Generator()}
    return Lags(delay, **(given | values))


def test_lags_are_uniform_in_seconds_and_rounded_to_physics_steps():
    drawn = lags().draw((0.0, 0.02), (100_000,))
    share = torch.bincount(drawn) / 100_000
    expected = torch.tensor([0.1, 0.2, 0.2, 0.2, 0.2, 0.1])  # the ends get half a step each
    torch.testing.assert_close(share, expected, atol=0.007, rtol=0)


def test_each_world_has_its_own_bounds():
    bounds = torch.tensor([[0.0, 0.02, 0.1], [0.0, 0.02, 0.1]])
    assert lags().draw(bounds, (3,)).tolist() == [0, 5, 25]
    assert lags().draw(bounds, (3, 2)).tolist() == [[0, 0], [5, 5], [25, 25]]


@pytest.mark.parametrize("bounds", [(0.0, 0.2), (-0.01, -0.01)])
def test_bounds_set_later_stay_within_the_buffer(bounds):
    with pytest.raises(ValueError, match=r"delay must stay within \[0, max_delay\]"):
        lags().draw(bounds, (64,))


@pytest.mark.parametrize("delay", [(0.02, 0.01), (-0.01, 0.01), (0.0, 0.11), (0.0,)])
def test_bounds_out_of_order_are_refused(delay):
    with pytest.raises(
        ValueError, match=r"delay must be \[shortest, longest\] within \[0, max_delay\]"
    ):
        lags(delay)
