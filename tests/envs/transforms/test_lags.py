"""Delays in physics steps."""

import pytest
import torch

from zfall.envs.streams import Stream, Streams
from zfall.envs.transforms.lags import Lags


def stream(num_envs: int) -> Stream:
    return Streams(num_envs).of("delay")


def lags(delay=(0.0, 0.02), **values) -> Lags:
    given = {"max_delay": 0.1, "per": "episode", "physics_dt": 0.004}
    return Lags(delay, **(given | values))


def test_lags_are_uniform_in_seconds_and_rounded_to_physics_steps():
    drawn = lags().draw((0.0, 0.02), (100_000,), stream(100_000))
    share = torch.bincount(drawn) / 100_000
    expected = torch.tensor([0.1, 0.2, 0.2, 0.2, 0.2, 0.1])  # the ends get half a step each
    torch.testing.assert_close(share, expected, atol=0.007, rtol=0)


def test_each_world_has_its_own_bounds():
    bounds = torch.tensor([[0.0, 0.02, 0.1], [0.0, 0.02, 0.1]])
    assert lags().draw(bounds, (3,), stream(3)).tolist() == [0, 5, 25]
    assert lags().draw(bounds, (3, 2), stream(3)).tolist() == [[0, 0], [5, 5], [25, 25]]


@pytest.mark.parametrize("bounds", [(0.0, 0.2), (-0.01, -0.01)])
def test_bounds_set_later_stay_within_the_buffer(bounds):
    with pytest.raises(ValueError, match=r"delay must stay within \[0, max_delay\]"):
        lags().draw(bounds, (64,), stream(64))


@pytest.mark.parametrize("delay", [(0.02, 0.01), (-0.01, 0.01), (0.0, 0.11)])
def test_bounds_out_of_order_are_refused(delay):
    with pytest.raises(
        ValueError, match=r"delay must be \[shortest, longest\] within \[0, max_delay\]"
    ):
        lags(delay)


@pytest.mark.parametrize("delay", [0.02, "fast", ["a", "b"], (0.0,), (0.0, float("inf"))])
def test_what_is_no_pair_is_refused(delay):
    with pytest.raises(ValueError, match="delay must be two finite numbers, got"):
        lags(delay)


def test_the_longest_delay_may_lie_between_two_physics_steps():
    """0.0225 s of 5 ms are 4.5 steps: the buffer holds 4, whatever float32 makes of it."""
    given = lags((0.0225, 0.0225), max_delay=0.0225, physics_dt=0.005)
    assert given.draw((0.0225, 0.0225), (3,), stream(3)).tolist() == [4, 4, 4]
