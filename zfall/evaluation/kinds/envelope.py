"""The largest push recovered from, by direction and push point, found by bisection."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from zfall.evaluation.definitions import Battery, check_single, check_unused
from zfall.evaluation.kinds import Figures
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import Pushes, grid, single_pushes
from zfall.evaluation.plots import envelope_plot
from zfall.evaluation.results import Result
from zfall.evaluation.statistics import head
from zfall.evaluation.writers import Written, write_figures, write_table
from zfall.terminal import Sheet
from zfall.values import shown


class Envelope:
    """Bisects the size of every cell, direction x push point, all at once.

    A cell recovers from an impulse if most of its ``starts`` do, the same ones at every impulse;
    whether it would fall at a smaller one again is not looked for.
    """

    independent: ClassVar[bool] = False
    baseline_task: ClassVar[str] = "push_recovery"
    study_figures: ClassVar[Figures] = {
        "largest_mean": ("largest push, mean", 3),
        "largest_min": ("largest push, least", 2),
        "control_falls": ("falls without a push", 1),
    }
    needs_training_size: ClassVar[bool] = False

    plan = staticmethod(grid)
    pushes = staticmethod(single_pushes)

    def check(self, battery: Battery) -> None:
        """A resolution within the sizes that are looked for, one duration."""
        resolution = battery.resolution
        if resolution is None or resolution >= max(battery.impulses):
            raise ValueError(
                f"battery.resolution must be below {max(battery.impulses):g}, the largest of "
                f"impulses, got {shown(resolution)}."
            )
        check_unused(battery, "interval", "forces", "commands")
        check_single(battery, "duration")

    def columns(self, pushes: Pushes, outcomes: Outcomes) -> Mapping[str, NDArray[np.generic]]:
        """None."""
        return {}

    def run(
        self, battery: Battery, trials: pd.DataFrame, run: Callable[[pd.DataFrame], pd.DataFrame]
    ) -> pd.DataFrame:
        """The trials that it took, with the ``round`` of each; 0 is the control arm."""
        top = max(battery.impulses)
        resolution = battery.resolution or top
        pushed = trials[trials["impulse"] == top].reset_index(drop=True)
        cells = len(pushed) // battery.starts
        low, high = np.zeros(cells), np.full(cells, top)
        rounds = [run(trials[trials["impulse"] == 0.0]).assign(round=0)]
        tried = np.full(cells, top)  # first whether it falls at all
        while len(rounds) == 1 or (high - low).max() > resolution + 1e-9:
            outcome = run(pushed.assign(impulse=np.repeat(tried, battery.starts)))
            rounds.append(outcome.assign(round=len(rounds)))
            share = outcome["recovered"].to_numpy().reshape(cells, battery.starts).mean(1)
            good = share > 0.5
            low = np.where(good, tried, low)
            high = np.where(good, high, tried)
            tried = 0.5 * (low + high)
        return pd.concat(rounds, ignore_index=True)

    def background(self, battery: Battery) -> Battery | None:
        """All of it: the two envelopes are drawn together."""
        return battery

    def summary(self, battery: Battery, trials: pd.DataFrame) -> dict[str, Any]:
        """Mean and least of the largest impulses, by push point."""
        means = _by_body(trials)
        return head(battery, trials) | {
            "largest_mean": means["mean"].to_dict(),
            "largest_min": means["min"].to_dict(),
        }

    def write(self, result: Result, folder: Path) -> Written:
        """The largest impulses of a policy, drawn with those of ``pose_hold``."""
        tables = {result.name: envelope_table(result.trials)}
        if result.background is not None:
            tables["pose_hold"] = envelope_table(result.background)
        lines = result.lines
        battery = result.battery
        counted = f"{battery.starts} starts per push, to {battery.resolution:g} in I"
        title = result.heading(counted, of="Largest push recovered from")
        files = write_table(folder, "envelope", tables[result.name])
        files += write_figures(
            folder, "envelope", lambda path: envelope_plot(tables, path, title=title, lines=lines)
        )
        return Written(files, [Sheet(_by_body(result.trials).reset_index(), "largest impulse")])

    def compare(self, results: Mapping[str, Result], folder: Path) -> Written:
        """Nothing: other policies are put to other trials."""
        return Written()

    def study_row(
        self, battery: Battery, trials: pd.DataFrame, training_size: str
    ) -> dict[str, float]:
        """``study_figures``, over all push points."""
        largest = envelope_table(trials)["largest"]
        return {
            "largest_mean": float(largest.mean()),
            "largest_min": float(largest.min()),
            "control_falls": head(battery, trials)["control_falls"],
        }


def envelope_table(trials: pd.DataFrame) -> pd.DataFrame:
    """One row per cell, direction x push point, from the trials of all rounds.

    ``direction_rad``, ``body``; ``largest``, the largest impulse that was recovered from, 0 if
    none; ``smallest_failed``, NaN if it withstood the largest that is looked for.
    """
    rows = []
    pushed = trials[trials["round"] > 0]
    for (body, heading), cell in pushed.groupby(["body", "direction_rad"], sort=False):
        share = cell.groupby("round")["recovered"].mean()
        tried = cell.groupby("round")["impulse"].first()
        good = share > 0.5
        rows.append(
            {
                "direction_rad": heading,
                "body": body,
                "largest": tried[good].max() if good.any() else 0.0,
                "smallest_failed": tried[~good].min(),
            }
        )
    return pd.DataFrame(rows)


def _by_body(trials: pd.DataFrame) -> pd.DataFrame:
    table: pd.DataFrame = (
        envelope_table(trials).groupby("body", sort=False)["largest"].agg(["mean", "min"])
    )
    return table
