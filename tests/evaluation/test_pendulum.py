"""Bounds of the pendulum against a simulated one, and published figures."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from zfall.evaluation.pendulum import (
    FOOT_RADIUS,
    STEP_TIME,
    duration_factor,
    endless_stepping_bound,
    no_step_bound,
    references,
    stand_support,
)
from zfall.robots import GRAVITY, ZEROTH01


@pytest.mark.parametrize("duration", [0.02, 0.1, 0.4])
def test_a_pendulum_on_the_edge_of_its_foot_tips_just_above_the_bound(duration):
    """x'' = w^2 (x - p) + F / m, with the center of pressure p at the edge from the start on."""
    height, edge = ZEROTH01.com_height, 0.05
    omega2 = GRAVITY / height
    bound = edge / height * duration_factor(duration, height)

    def end(impulse: float) -> float:
        acceleration = impulse * (GRAVITY * height) ** 0.5 / duration

        def motion(t: float, state: np.ndarray) -> list[float]:
            push = acceleration if t < duration else 0.0
            return [state[1], omega2 * (state[0] - edge) + push]

        first = solve_ivp(motion, (0, duration), [0.0, 0.0], rtol=1e-10, atol=1e-12)
        later = solve_ivp(motion, (duration + 1e-12, 3.0), first.y[:, -1], rtol=1e-10, atol=1e-12)
        return float(later.y[0, -1])

    assert end(0.999 * bound) < edge < end(1.001 * bound)


def test_bounds_are_those_of_the_bare_feet():
    """0.34 and 0.69 N s/kg fore and aft and sideways, and 1.04 for endless steps, in 0.1 s."""
    speed = (GRAVITY * ZEROTH01.com_height) ** 0.5
    factor = duration_factor(0.1, ZEROTH01.com_height)
    assert factor == pytest.approx(1.37, abs=0.005)
    ahead, left = no_step_bound(ZEROTH01, [0.0, np.pi / 2], 0.1)
    assert ahead / factor * speed == pytest.approx(0.34, abs=0.01)
    assert left / factor * speed == pytest.approx(0.69, abs=0.01)
    assert endless_stepping_bound(ZEROTH01, 0.1) == pytest.approx(1.04, abs=0.01)


def test_bounds_of_a_robot_of_another_size_are_the_same_in_its_own_units():
    """Four times as high: a push, and the first step's delay, of twice the time."""
    giant = SimpleNamespace(com_height=4 * ZEROTH01.com_height, mass=10.0)
    bound = endless_stepping_bound(ZEROTH01, 0.1, delay=0.06)
    assert endless_stepping_bound(giant, 0.2, delay=0.12) == pytest.approx(bound)


@pytest.mark.parametrize("delay", [0.0, 0.06])
def test_endless_steps_that_begin_late_take_up_just_less_than_the_bound(delay):
    """The capture point of a sudden push, from foot to foot: xi' = w (xi - p)."""
    omega = (GRAVITY / ZEROTH01.com_height) ** 0.5

    def falls(impulse: float) -> bool:
        ahead, foot = impulse * ZEROTH01.com_height, 0.0
        for seconds in (delay, *[STEP_TIME] * 60):
            edge = foot + FOOT_RADIUS
            ahead = edge + (ahead - edge) * np.exp(omega * seconds)
            foot += 0.0 if seconds == delay else 0.12
        return ahead - foot > 1.0

    bound = endless_stepping_bound(ZEROTH01, 1e-9, delay=delay, step_length=0.12)
    assert falls(1.001 * bound)
    assert not falls(0.999 * bound)


def test_support_is_that_of_two_soles_beside_each_other():
    corners = stand_support(ZEROTH01)
    length, width = ZEROTH01.sole_half_size
    assert corners.shape == (8, 2)
    assert np.ptp(corners[:4, 0]) == pytest.approx(2 * length, rel=0.01)
    assert np.ptp(corners[:4, 1]) == pytest.approx(2 * width, rel=0.01)
    assert corners[:4, 1].min() > 0 > corners[4:, 1].max()  # left, then right


def test_published_robots_are_scaled_to_the_duration():
    by_name = {line.name: line for line in references(ZEROTH01, 0.1)}
    assert by_name["iCub"].impulse.max() == pytest.approx(0.73, abs=0.015)  # 36 N
    assert by_name["Atalante"].impulse.max() == pytest.approx(18 * 0.1 / 4.92, abs=0.02)
    assert len(by_name["Atalante"].angle) == 2
