"""Headings and times against the distributions they should have."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import expon, kstest
from scipy.stats import uniform as uniform_law

from zfall.envs.streams import Streams
from zfall.envs.transforms.pushes.draws import Timing, between, heading, of_worlds, uniform


def test_spherical_headings_are_uniform_in_every_coordinate():
    """On a sphere each coordinate is uniform on [-1, 1] (Archimedes)."""
    vectors = heading("spherical", np.random.default_rng(0).random((2, 4000)))
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), 1.0, atol=1e-6)
    for axis in range(3):
        assert kstest(vectors[:, axis], uniform_law(-1, 2).cdf).pvalue > 1e-3


def test_planar_headings_are_level_and_cover_the_circle():
    vectors = heading("planar", np.random.default_rng(0).random((2, 4000)))
    assert np.abs(vectors[:, 2]).max() == 0
    angle = np.arctan2(vectors[:, 1], vectors[:, 0])
    assert kstest(angle, uniform_law(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3


def test_a_fixed_heading_is_a_unit_vector():
    vectors = heading([0, 3, 4], np.zeros((2, 2)))
    np.testing.assert_allclose(vectors, [[0.0, 0.6, 0.8]] * 2, atol=1e-7)


def test_exponential_rests_make_the_mean_time_from_push_to_push():
    timing = Timing(None, 3.0, None, longest=0.9, mean=0.5, control_dt=0.04)
    zero = torch.zeros(4000, dtype=torch.float64)
    rests = timing.next(np.arange(4000), torch.rand(4000).numpy(), zero, zero, zero.long())
    assert kstest(rests, expon(scale=2.5).cdf).pvalue > 1e-3  # 3 s less the push itself


def test_bounds_may_differ_from_world_to_world():
    bounds = torch.tensor([[0.0, 1.0], [2.0, 1.5]])
    assert between(bounds, torch.tensor([0.5, 0.5])).tolist() == [1.0, 1.25]
    assert of_worlds(bounds, np.array([1])).tolist() == [[1.0], [1.5]]
    assert of_worlds([3.0, 4.0], np.array([1])) == [3.0, 4.0]


def test_times_are_those_of_the_worlds_that_need_one():
    """Third and first of three worlds, the rests of all of which a curriculum has moved."""
    index, u = np.array([2, 0]), np.array([0.5, 0.25], dtype=np.float32)
    rest_from = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    last, count = rest_from - 0.5, torch.tensor([1, 2, 3])
    timing = Timing([1.0, 2.0], None, None, longest=0.2, mean=0.1, control_dt=0.04)
    timing.interval = torch.tensor([[1.0, 9.0, 2.0], [2.0, 9.0, 4.0]])
    assert timing.next(index, u, rest_from, last, count).tolist() == [6.0, 2.25]
    timing = Timing(None, 3.0, None, longest=0.2, mean=0.1, control_dt=0.04)
    timing.mean_interval = torch.tensor([1.1, 9.0, 2.1])
    rests = timing.next(index, u, rest_from, last, count)
    assert rests == pytest.approx([3.0 + 2.0 * math.log(2.0), 1.0 - math.log(0.75)])
    timing = Timing(None, None, [0.5, 1.0, 2.0], longest=0.2, mean=0.1, control_dt=0.04)
    assert timing.next(index, u, rest_from, last, count).tolist() == [math.inf, 1.0]


def test_numbers_of_a_world_do_not_depend_on_which_others_need_some():
    rows = torch.tensor([False, True, True, False, True])
    index, u = uniform(3, rows, Streams(5).of("push"))
    assert index.tolist() == [1, 2, 4]
    everyone = uniform(3, torch.ones(5, dtype=torch.bool), Streams(5).of("push"))[1]
    assert (u == everyone[:, index]).all()
    assert ((u >= 0) & (u < 1)).all()
    assert len(set(everyone.flatten().tolist())) == 15


@pytest.mark.parametrize(("values", "message"), [
    ((None, None, None), "give just one of interval, mean_interval, times, got none"),
    (([1, 2], 3.0, None), "got interval, mean_interval"),
    (([2, 1], None, None), r"interval must be \[smallest, largest\], got \[2, 1\]"),
    ((None, 0.1, None), r"mean_interval must be longer than a push \(0.2\), got 0.1"),
    ((None, None, [1.0, 1.1]), r"times must grow from 0 on by at least .*\(0.24\), got \[1.0, 1.1\]"),
    ((None, None, []), "times must grow"),
])  # fmt: skip
def test_bad_timings_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        Timing(*values, longest=0.2, mean=0.2, control_dt=0.04)


@pytest.mark.parametrize("direction", ["up", [0, 0, 0], [1, 0]])
def test_bad_directions_are_refused(direction):
    with pytest.raises(ValueError, match="direction must be planar, spherical or a vector"):
        heading(direction, np.zeros((2, 1)))
