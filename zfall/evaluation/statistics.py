"""From trials to figures that can be compared."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binom, binomtest

from zfall.evaluation.comparison import bootstrap_interval
from zfall.evaluation.definitions import Battery


def wilson(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson interval of a success rate (Wilson, JASA 1927)."""
    interval = binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def largest_withstood(impulses: np.ndarray, rates: np.ndarray, share: float) -> float:
    """Largest impulse such that at it and all smaller tested ones the rate is at least ``share``.

    Args:
        impulses: tested sizes, rising ``(K,)``.
        rates: success rate at each ``(K,)``.
        share: 0.5 for I50, 0.9 for I90.

    Returns:
        One of ``impulses``, or 0 if already the smallest fails.
    """
    good = np.logical_and.accumulate(rates >= share - 1e-9)
    return float(impulses[good][-1]) if good.any() else 0.0


def i50_error(trials: pd.DataFrame) -> float | None:
    """Standard error of the mean I50 over directions, from the number of starts alone.

    ``None`` where a cell has less than two trials, of which nothing can be said.

    Each cell of direction and size is taken as so many throws of its own rate (the parametric
    bootstrap), of which the chance that at least half succeed is known: nothing is drawn.

    Args:
        trials: of a planar battery, with ``recovered``.
    """
    pushed = trials[trials["impulse"] > 0].astype({"recovered": int})
    cells = pushed.groupby(["direction_rad", "impulse"])["recovered"]
    won, tried = (each.unstack().to_numpy() for each in (cells.sum(), cells.size()))
    if not (tried >= 2).all():  # nor is it where a cell is missing
        return None
    sizes = np.sort(pushed["impulse"].unique())
    passes = binom.sf(np.ceil(0.5 * tried - 1e-9) - 1, tried, won / tried)
    reached = np.cumprod(passes, axis=1)  # chance that I50 is at least so large
    mean = reached @ np.diff(sizes, prepend=0.0)
    square = reached @ np.diff(sizes**2, prepend=0.0)
    return float(np.sqrt(np.maximum(square - mean**2, 0.0).sum()) / len(won))


def error_of(summary: Mapping[str, Any]) -> str:
    """The standard error of a summary's mean I50 in words, behind it; nothing where none is known.

    Summaries from before 2026-11-29 have none.
    """
    error = summary.get("i50_mean_error")
    return "" if error is None else f" (standard error {error:.3f})"


def success_table(trials: pd.DataFrame) -> pd.DataFrame:
    """Success rate by direction (rows) and impulse (columns) of the pushed trials."""
    pushed = trials[trials["impulse"] > 0]
    return pushed.pivot_table(
        index="direction_rad", columns="impulse", values="recovered", aggfunc="mean"
    )


def withstood_table(trials: pd.DataFrame) -> pd.DataFrame:
    """Mean pushes withstood in a row by ``body``, ``duration_s`` and ``impulse``.

    Columns besides: ``withstood_low``, ``withstood_high``, its bootstrap 95 % interval over
    episodes, and ``fell``, the share of them that ended in a fall.
    """
    rows = []
    for (body, duration, impulse), group in trials[trials["impulse"] > 0].groupby(
        ["body", "duration_s", "impulse"], sort=False
    ):
        low, high = bootstrap_interval(group["withstood"].tolist())
        rows.append(
            {
                "body": body,
                "duration_s": duration,
                "impulse": impulse,
                "withstood": float(group["withstood"].mean()),
                "withstood_low": low,
                "withstood_high": high,
                "fell": float(group["fell"].mean()),
            }
        )
    return pd.DataFrame(rows)


def head(battery: Battery, trials: pd.DataFrame) -> dict[str, Any]:
    """What every summary says."""
    control = trials[trials["impulse"] == 0]
    return {
        "battery": battery.name,
        "battery_version": battery.version,
        "definition": asdict(battery),
        "seed": int(trials["seed"].iloc[0]),
        "n": len(trials),
        "control_falls": int(control["fell"].sum()),
        "control_n": len(control),
    }


def summarize(battery: Battery, trials: pd.DataFrame) -> dict[str, Any]:
    """The summary of a planar battery: headline figures and success by impulse.

    ``i50_mean_error`` is the standard error of ``i50_mean``. ``success`` at an impulse is over all
    directions and starts, with its Wilson 95 % interval.
    ``control_falls`` are trials without a push in which something but the feet met the floor.
    """
    table = success_table(trials)
    impulses = table.columns.to_numpy()
    i50 = [largest_withstood(impulses, rates, 0.5) for rates in table.to_numpy()]
    i90 = [largest_withstood(impulses, rates, 0.9) for rates in table.to_numpy()]
    control = trials[trials["impulse"] == 0]
    summary: dict[str, Any] = head(battery, trials) | {
        "i50_mean": float(np.mean(i50)),
        "i50_mean_error": i50_error(trials),
        "i50_min": float(np.min(i50)),
        "i90_mean": float(np.mean(i90)),
        "i90_min": float(np.min(i90)),
        "i50": i50,
        "i90": i90,
        "directions_rad": [float(d) for d in table.index],
        "success": {},
        "success_low": {},
        "success_high": {},
        "force_n": {},
        "target_smoothness": float(control["target_smoothness"].mean()),
    }
    for impulse, group in trials[trials["impulse"] > 0].groupby("impulse"):
        key, successes = f"{impulse:g}", int(group["recovered"].sum())
        summary["success"][key] = successes / len(group)
        low, high = wilson(successes, len(group))
        summary["success_low"][key], summary["success_high"][key] = low, high
        summary["force_n"][key] = float(group["force_n"].iloc[0])
    return summary
