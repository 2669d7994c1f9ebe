"""Comparisons against SciPy, closed forms, and by hand."""

from math import comb

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from zfall.evaluation.comparison import (
    bootstrap_interval,
    compare,
    interquartile_mean,
    mcnemar,
    performance_profile,
    ratio_interval,
)


@pytest.mark.parametrize(("better", "worse"), [(1, 9), (0, 6), (5, 5), (30, 12)])
def test_mcnemar_is_the_tail_of_a_fair_coin(better, worse):
    """Twice the probability of so few heads; at most 1."""
    first = [True] * better + [False] * worse + [True] * 7 + [False] * 4
    second = [False] * better + [True] * worse + [True] * 7 + [False] * 4
    total = better + worse
    tail = sum(comb(total, k) for k in range(min(better, worse) + 1)) / 2**total
    assert mcnemar(first, second) == pytest.approx(min(1.0, 2 * tail))
    assert mcnemar(second, first) == mcnemar(first, second)


def test_mcnemar_of_equal_policies_is_one():
    assert mcnemar([True, False], [True, False]) == 1.0
    with pytest.raises(ValueError, match="must have the same trials"):
        mcnemar([True], [True, False])


def test_bootstrap_of_many_values_is_the_normal_interval():
    """Mean of 400 normal numbers: deviation / sqrt(400) times 1.96 to either side."""
    values = np.random.default_rng(0).normal(2.0, 3.0, 400)
    low, high = bootstrap_interval(values)
    half = stats.norm.ppf(0.975) * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.03)
    assert high == pytest.approx(values.mean() + half, abs=0.03)
    assert bootstrap_interval(values) == (low, high)
    assert bootstrap_interval([0.7]) == (0.7, 0.7)


def test_bootstrap_of_a_ratio_is_the_interval_of_its_linearisation():
    """Pairs that share a factor: deviation of ``(x - r y) / mean(y)`` / sqrt(400), times 1.96."""
    rng = np.random.default_rng(0)
    shared = rng.uniform(1.0, 3.0, 400)
    x, y = shared * rng.uniform(0.5, 1.0, 400), shared * rng.uniform(0.9, 1.1, 400)
    low, high = ratio_interval(x, y)
    ratio = x.mean() / y.mean()
    half = stats.norm.ppf(0.975) * ((x - ratio * y) / y.mean()).std() / 20
    assert low == pytest.approx(ratio - half, abs=0.1 * half)
    assert high == pytest.approx(ratio + half, abs=0.1 * half)
    assert ratio_interval(x, x) == (1.0, 1.0)


def test_interquartile_mean_leaves_out_a_quarter_at_either_end():
    assert interquartile_mean([100.0, 1.0, 2.0, -50.0]) == 1.5
    values = np.random.default_rng(1).standard_cauchy(1000)
    middle = np.sort(values)[250:750]
    assert interquartile_mean(values) == pytest.approx(middle.mean())


def test_performance_profile_is_one_minus_the_distribution():
    values = np.random.default_rng(2).normal(size=500)
    thresholds = np.linspace(-2, 2, 9)
    expected = 1 - stats.ecdf(values).cdf.evaluate(thresholds)
    np.testing.assert_allclose(performance_profile(values, thresholds), expected)


def trials(recovered: list[bool], seed: int = 0) -> pd.DataFrame:
    count = len(recovered)
    return pd.DataFrame(
        {"trial": range(count), "direction_rad": 0.0, "impulse": [0.0, *[0.3] * (count - 1)],
         "duration_s": 0.1, "body": "torso", "seed": seed, "recovered": recovered}
    )  # fmt: skip


def test_comparison_by_hand():
    """Control trials do not count: of five pushes A wins 2, B 4, one of A's being lost."""
    table = compare(
        {
            "A": trials([False, True, True, False, False, False]),
            "B": trials([True, True, False, True, True, True]),
        }
    ).set_index("run")
    assert table.loc["A", ["success", "difference", "gained", "lost", "p"]].tolist() == [
        0.4, 0.0, 0, 0, 1.0,
    ]  # fmt: skip
    assert table.loc["B", "difference"] == pytest.approx(0.4)
    assert (table.loc["B", "gained"], table.loc["B", "lost"]) == (3, 1)
    assert table.loc["B", "p"] == pytest.approx(2 * 5 / 16)


def test_other_trials_cannot_be_compared():
    with pytest.raises(ValueError, match="runs must have the same trials, B and A have not"):
        compare({"A": trials([True, True]), "B": trials([True, True], seed=1)})
