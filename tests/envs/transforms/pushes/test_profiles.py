"""Shapes of pushes against their force as a function of time, integrated by SciPy."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from zfall.envs.transforms.pushes.profiles import PROFILES, find_profile, force_share

LENGTH = 0.13  # [s]
FORCES = {  # share of the peak at time t of a push of that length
    "rectangular": lambda t: 1.0,
    "half_sine": lambda t: math.sin(math.pi * t / LENGTH),
    "gaussian": lambda t: math.exp(-0.5 * ((t - LENGTH / 2) / (LENGTH / 6)) ** 2),
    "ramp": lambda t: t / LENGTH,
}


@pytest.mark.parametrize("name", list(PROFILES))
@pytest.mark.parametrize("physics_dt", [0.001, 0.004, 0.005])
def test_every_physics_step_carries_the_mean_force_of_its_time(name, physics_dt):
    begin = physics_dt * np.arange(60)
    start = np.array([0.0317])
    share = force_share(begin, physics_dt, start, LENGTH, PROFILES[name])[0]
    for i in range(60):
        times = (i * physics_dt - 0.0317, (i + 1) * physics_dt - 0.0317)
        low, high = (min(max(time, 0.0), LENGTH) for time in times)
        expected = quad(FORCES[name], low, high, epsabs=1e-13)[0] / physics_dt
        assert share[i] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("name", list(PROFILES))
def test_mean_is_the_mean_force(name):
    assert PROFILES[name].mean == pytest.approx(quad(FORCES[name], 0, LENGTH)[0] / LENGTH)


def test_a_push_shorter_than_a_physics_step_keeps_its_impulse():
    begin = 0.004 * np.arange(10)
    start = np.array([0.0055])
    share = force_share(begin, 0.004, start, 0.001, PROFILES["half_sine"])
    assert 0.004 * share.sum() == pytest.approx(0.001 * 2 / math.pi)
    assert (share > 0).sum() == 1


def test_unknown_profile_is_refused():
    with pytest.raises(ValueError, match="profile must be one of rectangular, .*got 'square'"):
        find_profile("square")
