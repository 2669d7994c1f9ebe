"""The kind of battery ``cycle``: pushed over and over, does the robot get up every time?"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from zfall.evaluation.comparison import bootstrap_interval
from zfall.evaluation.definitions import Battery, check_single, check_unused
from zfall.evaluation.kinds import Figures
from zfall.evaluation.kinds.spherical import random_pushes
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import Pushes, cells, numbered, pushes_along
from zfall.evaluation.results import Result
from zfall.evaluation.statistics import head
from zfall.evaluation.writers import Written, write_table
from zfall.terminal import Sheet

# What a summary says: by its name, the sums of ``Cycling`` that are divided, and a factor.
RATES: Mapping[str, tuple[str, str, float]] = {
    "stood_share": ("falls_stood", "falls_over", 1.0),
    "pushes_met_per_minute": ("pushes_met", "minutes", 1.0),
    "down_share": ("down_s", "minutes", 1.0 / 60.0),
    "landing_force": ("landing_force", "falls", 1.0),
    "landing_torque": ("landing_torque", "falls", 1.0),
    "landing_vulnerable": ("landing_vulnerable", "falls", 1.0),
    "rise_force": ("rise_force", "falls", 1.0),
}


class Cycle:
    """Sizes x ``starts`` episodes; level pushes from all sides, on average every ``interval``."""

    independent: ClassVar[bool] = True
    baseline_task: ClassVar[str] = "push_to_stand"
    study_figures: ClassVar[Figures] = {
        "stood_share": ("falls that end standing in 8 s", 3),
        "pushes_met_per_minute": ("pushes met per minute", 2),
        "landing_force": ("force of a landing [N]", 0),
    }
    needs_training_size: ClassVar[bool] = False

    def check(self, battery: Battery) -> None:
        """A mean rest between pushes, one point and duration, and no end at a fall."""
        check_unused(battery, "resolution", "forces", "commands", "aftermath")
        check_single(battery, "duration", "point")
        if battery.interval is None:
            raise ValueError("battery.interval must be a number of seconds, got null.")

    def plan(self, battery: Battery, impulse_unit: float, seed: int) -> pd.DataFrame:
        """Rows without a direction: each push of a trial has its own; no control arm."""
        rows = [row for row in cells(battery, [np.nan]) if row["impulse"] > 0]
        return numbered(rows, impulse_unit, seed)

    def pushes(self, battery: Battery, trials: pd.DataFrame) -> Pushes:
        """Those of battery ``spherical``, made level."""
        columns = trials["trial"], trials["seed"], trials["duration_s"]
        drawn = [random_pushes(battery, d, s, t) for t, s, d in zip(*columns, strict=True)]
        events = max([1, *(len(times) for times, _ in drawn)])
        time = torch.full((len(trials), events), torch.inf, dtype=torch.float64)
        unit = torch.zeros(len(trials), events, 3, dtype=torch.float64)
        for row, (times, directions) in enumerate(drawn):
            level = directions * [1.0, 1.0, 0.0]
            time[row, : len(times)] = torch.tensor(times)
            unit[row, : len(times)] = torch.tensor(
                level / np.linalg.norm(level, axis=1, keepdims=True)
            )
        return pushes_along(battery, trials, time, unit)

    def columns(self, pushes: Pushes, outcomes: Outcomes) -> Mapping[str, NDArray[np.generic]]:
        """None: those of ``Cycling`` are measured."""
        return {}

    def background(self, battery: Battery) -> Battery | None:
        """None."""
        return None

    def summary(self, battery: Battery, trials: pd.DataFrame) -> dict[str, Any]:
        """``RATES`` over all episodes, and by size of the pushes."""
        groups = {"all": trials} | {f"{i:g}": group for i, group in trials.groupby("impulse")}
        figures = {name: cycle_figures(group, battery.end_time) for name, group in groups.items()}
        return head(battery, trials) | figures["all"] | {"cycle": figures}

    def write(self, result: Result, folder: Path) -> Written:
        """The table of the summary."""
        rows = cycle_table(result.summary)
        return Written(
            write_table(folder, "cycle", rows), [Sheet(rows, file=str(folder / "cycle.csv"))]
        )

    def compare(self, results: Mapping[str, Result], folder: Path) -> Written:
        """The tables of all."""
        tables = [cycle_table(result.summary) for result in results.values()]
        rows = pd.concat(tables, keys=list(results)).reset_index(0, names="run")
        return Written(write_table(folder, "cycle", rows))

    def study_row(
        self, battery: Battery, trials: pd.DataFrame, training_size: str
    ) -> dict[str, float]:
        """``study_figures``."""
        figures = cycle_figures(trials, battery.end_time)
        values = {key: figures[key] for key in self.study_figures}
        return {key: float("nan") if x is None else x for key, x in values.items()}


def cycle_figures(trials: pd.DataFrame, seconds: float) -> dict[str, Any]:
    """Numbers of episodes, falls and pushes, and ``RATES`` with intervals; ``None`` of no falls.

    Intervals are 95 % bootstrap intervals over episodes, of each ratio of sums: falls of one
    episode share its draw, and how often a robot falls depends on whether it gets up.

    Args:
        trials: with the columns of ``Cycling``.
        seconds: length of an episode.
    """
    sums = trials.assign(falls_over=trials["falls"] - trials["falls_open"], minutes=seconds / 60.0)
    totals = sums.select_dtypes("number").sum()
    names = ("falls", "falls_over", "falls_stood", "pushes_met", "pushes_down")
    out: dict[str, Any] = {"episodes": len(trials)} | {name: int(totals[name]) for name in names}
    for name, (above, below, factor) in RATES.items():
        known = totals[below] > 0
        out[name] = float(factor * totals[above] / totals[below]) if known else None
        low, high = _interval(sums[above], sums[below]) if known else (None, None)
        out[f"{name}_low"] = None if low is None else factor * low
        out[f"{name}_high"] = None if high is None else factor * high
    return out


def _interval(above: pd.Series, below: pd.Series) -> tuple[float, float]:
    """95 % bootstrap interval over episodes of the ratio of two sums."""
    counted = below.to_numpy() > 0  # the others say nothing of the ratio
    tops, bottoms = above.to_numpy()[counted], below.to_numpy()[counted]

    def ratio(rows: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
        chosen = rows.astype(int)
        quotient: NDArray[np.float64] = tops[chosen].sum(axis) / bottoms[chosen].sum(axis)
        return quotient

    return bootstrap_interval(np.arange(float(len(tops))).tolist(), ratio)


def cycle_table(summary: Mapping[str, Any]) -> pd.DataFrame:
    """One row per size of the pushes, and one for all."""
    rows = []
    for size, entry in summary["cycle"].items():
        row: dict[str, Any] = {"I": size}
        row |= {key: entry[key] for key in ("episodes", "falls", "falls_over", "pushes_met")}
        for name in RATES:
            values = [entry[f"{name}{end}"] for end in ("", "_low", "_high")]
            known = all(value is not None for value in values)
            row[name] = "{:.3g} [{:.3g}, {:.3g}]".format(*values) if known else "-"
        rows.append(row)
    return pd.DataFrame(rows)
