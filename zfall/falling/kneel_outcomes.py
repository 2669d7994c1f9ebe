"""Figures of battery ``kneel``: who kneels, how cleanly, how hard the floor is met."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from zfall.evaluation.comparison import bootstrap_interval, ratio_interval
from zfall.evaluation.statistics import wilson

FEW = 10  # trials below which a mean has no interval
PEAKS = ("peak_base_acceleration", "peak_torso_head_force", "peak_joint_torque")


def summarize_kneel(trials: pd.DataFrame) -> dict[str, Any]:
    """Figures of battery ``kneel``: by impulse of the grid, and by force of the list.

    Each entry holds ``n``, ``recovered``, ``kneeled`` (of those not recovered), ``clean`` and
    ``untouched`` (without contact of torso or head: of the kneels, of all not recovered), each
    with ``_low`` and ``_high``, its Wilson 95 % interval, and the means of ``PEAKS`` over those
    not recovered, but for those that fell before the push, with a bootstrap interval over trials
    if there are ten; ``null`` if there is nothing to count.
    ``grid_falls`` and the means are of the grid, whose pushes hardly anyone recovers from: over the
    list they would be over other pushes for each policy.
    """
    pushed = trials[trials["impulse"] > 0]
    grid, listed = pushed[~pushed["listed"]], pushed[pushed["listed"]]
    fallen = grid[~grid["recovered"]]
    return {
        "by_impulse": {f"{size:g}": _outcomes(group) for size, group in grid.groupby("impulse")},
        "by_direction": {
            f"{np.degrees(group['direction_rad'].iloc[0]):.0f}": _outcomes(group)
            for _, group in grid.groupby("direction_rad")
        },
        "listed": {
            _force_name(group): _outcomes(group)
            for _, group in listed.groupby(["impulse", "direction_rad"], sort=False)
        },
        "grid_falls": len(fallen),
        **{f"grid_falls_{name}_mean": _mean(peaks) for name, peaks in peaks_of(fallen).items()},
        "grid_falls_impact_energy_mean": _mean(fallen["impact_energy"]),
        "grid_kneel_time_s_mean": _mean(fallen["kneel_time_s"]),
    }


def _mean(values: pd.Series) -> float | None:
    """Mean of those that are numbers, if any is."""
    mean = float(values.mean())
    return None if np.isnan(mean) else mean


def peaks_of(trials: pd.DataFrame) -> dict[str, pd.Series]:
    """``PEAKS`` of each trial: acceleration [m/s2], force on torso or head [N], torque [N m]."""
    torso_head = trials[["peak_contact_force/torso", "peak_contact_force/head"]].max(axis=1)
    values = (trials["peak_base_acceleration"], torso_head, trials["peak_joint_torque"])
    return dict(zip(PEAKS, values, strict=True))


def _fell_before(trials: pd.DataFrame) -> pd.Series:
    """Trials that had fallen when the push came: their peaks are those of lying there."""
    return trials["time_to_fall_s"] <= 0


def torso_or_head(trials: pd.DataFrame) -> pd.Series:
    """Trials in which torso or head touched the floor."""
    return (trials["peak_contact_force/torso"] > 0) | (trials["peak_contact_force/head"] > 0)


def _force_name(group: pd.DataFrame) -> str:
    """Forward and leftward force of trials that share it, ``(-45, 20)`` [N]."""
    force, heading = group["force_n"].iloc[0], group["direction_rad"].iloc[0]
    return f"({force * np.cos(heading):.0f}, {force * np.sin(heading):.0f})".replace("-0", "0")


def _outcomes(trials: pd.DataFrame) -> dict[str, Any]:
    fallen = trials[~trials["recovered"]]
    kneels = fallen[fallen["kneeled"]]
    touched = torso_or_head(kneels)
    counts = {
        "recovered": (int(trials["recovered"].sum()), len(trials)),
        "kneeled": (len(kneels), len(fallen)),
        "clean": (int((~touched).sum()), len(kneels)),
        "untouched": (int((~torso_or_head(fallen)).sum()), len(fallen)),
    }
    out: dict[str, Any] = {"n": len(trials)}
    for name, (successes, count) in counts.items():
        low, high = wilson(successes, count) if count else (None, None)
        out[name] = successes / count if count else None
        out[f"{name}_low"], out[f"{name}_high"] = low, high
    for name, peaks in peaks_of(fallen[~_fell_before(fallen)]).items():
        out[name] = _mean(peaks)
        low, high = bootstrap_interval(peaks.tolist()) if len(peaks) >= FEW else (None, None)
        out[f"{name}_low"], out[f"{name}_high"] = low, high
    return out


def compare_falls(runs: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Falls of several policies after the pushes of the grid after which, not before, all fell.

    Returns:
        One row per name: ``falls``, and of each of ``PEAKS`` and of ``torso_head_touched``, the
        share of falls in which torso or head touched the floor, its mean and the bootstrap 95 %
        interval over those pushes of the first run's mean divided by it, if there are ten.
    """
    grid = next(iter(runs.values()))
    fell = (grid["impulse"] > 0) & ~grid["listed"]
    for trials in runs.values():
        fell &= ~trials["recovered"] & ~_fell_before(trials)
    peaks = {
        name: peaks_of(trials[fell])
        | {"torso_head_touched": torso_or_head(trials[fell]).astype(float)}
        for name, trials in runs.items()
    }
    first, *_ = peaks.values()
    rows = []
    for name, own in peaks.items():
        row: dict[str, Any] = {"run": name, "falls": int(fell.sum())}
        for key, values in own.items():
            row[key] = _mean(values)
            known = len(values) >= FEW and (values > 0).any()  # limp has no torque
            low, high = ratio_interval(first[key], values) if known else (None, None)
            row |= {f"{key}_ratio_low": low, f"{key}_ratio_high": high}
        rows.append(row)
    return pd.DataFrame(rows)


def outcome_table(summary: dict[str, Any]) -> pd.DataFrame:
    """Outcomes of battery ``kneel``: a row for each push of the list, each size, each heading."""
    rows = []
    groups = {"force [N]": "listed", "I": "by_impulse", "heading [deg]": "by_direction"}
    for label, entries in ((label, summary[name]) for label, name in groups.items()):
        for push, entry in entries.items():
            row = {"push": f"{label} {push}", "n": entry["n"]}
            for key in ("recovered", "kneeled", "clean", "untouched"):
                row[key] = _percent(*(entry[f"{key}{end}"] for end in ("", "_low", "_high")))
            for key in PEAKS:
                row[key] = _interval(*(entry[f"{key}{end}"] for end in ("", "_low", "_high")))
            rows.append(row)
    return pd.DataFrame(rows)


def _percent(value: float | None, low: float | None, high: float | None) -> str:
    if value is None or low is None or high is None:
        return "-"
    return f"{100 * value:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def _interval(value: float | None, low: float | None, high: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if low is None or high is None else f"{value:.3g} [{low:.3g}, {high:.3g}]"
