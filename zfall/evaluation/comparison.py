"""Two and more policies on the same trials, and figures over seeds."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest, bootstrap, trim_mean

Array = NDArray[np.float64]


def mcnemar(first: ArrayLike, second: ArrayLike) -> float:
    """Probability of a difference at least as large if both were as good: exact and two-sided.

    Of the trials that one recovers from and the other does not, each is as likely to be either's.

    Args:
        first, second: whether each trial was recovered from ``(K,)`` bool, in the same order.

    Source: McNemar, Psychometrika 1947, in its exact form.
    """
    one, two = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    if one.shape != two.shape:
        raise ValueError(f"both must have the same trials, got {one.shape} and {two.shape}.")
    better, worse = int((one & ~two).sum()), int((~one & two).sum())
    return 1.0 if better + worse == 0 else float(binomtest(better, better + worse).pvalue)


def bootstrap_interval(
    values: Sequence[float],
    statistic: Callable[..., Any] = np.mean,
    *,
    confidence: float = 0.95,
    resamples: int = 9999,
    seed: int = 0,
) -> tuple[float, float]:
    """Percentile bootstrap interval of a statistic over seeds, or over trials of one plan.

    ``statistic`` takes an array and ``axis``, as ``np.mean`` does.

    Equal values are their own.
    """
    data = np.asarray(values, dtype=float)
    if len(data) < 2 or np.ptp(data) == 0.0:
        return float(statistic(data)), float(statistic(data))
    interval = bootstrap(
        (data,),
        statistic,
        n_resamples=resamples,
        confidence_level=confidence,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def ratio_interval(
    first: ArrayLike, second: ArrayLike, *, resamples: int = 9999, seed: int = 0
) -> tuple[float, float]:
    """Percentile bootstrap 95 % interval of ``mean(first) / mean(second)`` over their pairs."""
    pairs = (np.asarray(first, dtype=float), np.asarray(second, dtype=float))
    if np.array_equal(*pairs):
        return 1.0, 1.0
    interval = bootstrap(
        pairs,
        lambda one, two, axis: one.mean(axis) / two.mean(axis),
        paired=True,
        n_resamples=resamples,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def interquartile_mean(values: ArrayLike, axis: int = 0) -> float:
    """Mean of the middle half.

    Source: Agarwal et al., "Deep reinforcement learning at the edge of the statistical
    precipice", NeurIPS 2021.
    """
    return trim_mean(values, 0.25, axis=axis)


def performance_profile(values: ArrayLike, thresholds: ArrayLike) -> Array:
    """Share of values above each threshold ``(T,)`` (Agarwal et al. 2021)."""
    return (np.asarray(values)[:, None] > np.asarray(thresholds)).mean(0)


def compare(runs: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Success of several policies on the pushed trials of one battery, against the first one.

    Args:
        runs: trials by name; all of the same plan.

    Returns:
        One row per name: ``success``, ``difference`` to the first, trials that only it and that
        only the first recovered from (``gained``, ``lost``), and ``p`` of ``mcnemar``.

    Raises:
        ValueError: if the plans differ.
    """
    plan = ["trial", "direction_rad", "impulse", "duration_s", "body", "seed"]
    (reference, first), *_ = runs.items()
    rows = []
    for name, trials in runs.items():
        if not trials[plan].equals(first[plan]):
            raise ValueError(f"runs must have the same trials, {name} and {reference} have not.")
        pushed = trials["impulse"] > 0
        here, there = trials["recovered"][pushed], first["recovered"][pushed]
        rows.append(
            {
                "run": name,
                "success": here.mean(),
                "difference": here.mean() - there.mean(),
                "gained": int((here & ~there).sum()),
                "lost": int((there & ~here).sum()),
                "p": mcnemar(here, there),
            }
        )
    return pd.DataFrame(rows)
