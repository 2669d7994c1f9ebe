"""Figures of a battery against SciPy and by hand."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from zfall.evaluation.definitions import load_battery
from zfall.evaluation.statistics import (
    i50_error,
    largest_withstood,
    success_table,
    summarize,
    wilson,
)


@pytest.mark.parametrize(("successes", "trials"), [(0, 20), (7, 20), (20, 20), (199, 240)])
def test_wilson_interval_solves_its_equation(successes, trials):
    """At its ends |p - rate| = z sqrt(p (1 - p) / n), which defines the interval."""
    z, rate = norm.ppf(0.975), successes / trials
    for p in wilson(successes, trials):
        assert abs(p - rate) == pytest.approx(z * np.sqrt(p * (1 - p) / trials), abs=1e-9)


@pytest.mark.parametrize(("rates", "i50", "i90"), [
    ([1.0, 0.9, 0.5, 0.0], 0.3, 0.2),
    ([1.0, 0.4, 1.0, 1.0], 0.1, 0.1),  # a hole: what lies beyond it does not count
    ([0.4, 1.0, 1.0, 1.0], 0.0, 0.0),
    ([1.0, 1.0, 1.0, 1.0], 0.4, 0.4),
])  # fmt: skip
def test_largest_withstood_stops_at_the_first_failure(rates, i50, i90):
    impulses = np.array([0.1, 0.2, 0.3, 0.4])
    assert largest_withstood(impulses, np.array(rates), 0.5) == i50
    assert largest_withstood(impulses, np.array(rates), 0.9) == i90


@pytest.fixture
def trials() -> pd.DataFrame:
    """Two directions, two impulses, four starts: 1.0 and 0.5 ahead, 0.25 and 0.0 to the left."""
    outcomes = {
        (0.0, 0.1): 4,
        (0.0, 0.2): 2,
        (1.5, 0.1): 1,
        (1.5, 0.2): 0,
        (0.0, 0.0): 4,
        (1.5, 0.0): 3,
    }
    rows = [
        {
            "direction_rad": direction,
            "impulse": impulse,
            "recovered": i < good,
            "fell": i >= good,
            "force_n": 49.2 * impulse,
            "seed": 7,
            "target_smoothness": 0.1 * (impulse == 0.0) * (i + 1),
        }
        for (direction, impulse), good in outcomes.items()
        for i in range(4)
    ]
    return pd.DataFrame(rows)


def of_one_direction(starts, *won):
    """Trials of sizes 0.1, 0.2, ... from one direction."""
    return pd.DataFrame(
        [
            {"direction_rad": 0.0, "impulse": 0.1 * size, "recovered": start < good}
            for size, good in enumerate(won, 1)
            for start in range(starts)
        ]
    )


def test_a_size_counts_for_the_mean_only_if_the_smaller_ones_are_withstood():
    """One of four at 0.1, two of four at 0.2: at least half succeed 67 of 256, and 11 of 16 times."""
    small, large = 67 / 256, 11 / 16
    mean = 0.1 * small * (1 - large) + 0.2 * small * large
    square = 0.1**2 * small * (1 - large) + 0.2**2 * small * large
    assert i50_error(of_one_direction(4, 1, 2)) == pytest.approx(math.sqrt(square - mean**2))


def test_of_one_start_nothing_is_known():
    assert i50_error(of_one_direction(1, 1, 0)) is None
    gap = of_one_direction(2, 2, 1, 0)
    gap = pd.concat([gap, gap[gap["impulse"] < 0.25].assign(direction_rad=1.0)])
    assert i50_error(gap) is None


def test_success_table_holds_the_rates(trials):
    np.testing.assert_allclose(success_table(trials), [[1.0, 0.5], [0.25, 0.0]])


def test_summary_by_hand(trials):
    summary = summarize(load_battery("planar"), trials)
    assert summary["n"] == 24
    assert summary["i50"] == [0.2, 0.0]
    assert (summary["i50_mean"], summary["i50_min"]) == (0.1, 0.0)
    assert summary["i90"] == [0.1, 0.0]
    # Two of four throws at a half: 11 of 16 times; at a quarter 0.2617 of the times.
    variance = 0.1**2 * (11 / 16 * 5 / 16 + 0.26171875 * 0.73828125)
    assert summary["i50_mean_error"] == pytest.approx(math.sqrt(variance) / 2)
    assert summary["success"] == {"0.1": 5 / 8, "0.2": 2 / 8}
    assert summary["success_low"]["0.1"] < 5 / 8 < summary["success_high"]["0.1"]
    assert (summary["control_falls"], summary["control_n"]) == (1, 8)
    assert summary["battery_version"] == 1
    assert summary["target_smoothness"] == pytest.approx(0.25)  # mean of 0.1, 0.2, 0.3, 0.4
