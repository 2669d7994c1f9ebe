"""The kind of battery ``kneel``: how falls end that nobody recovers from."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from torchrl.envs import TransformedEnv

from zfall.evaluation.definitions import Battery, check_single, check_unused
from zfall.evaluation.kinds import Figures
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import Pushes, cells, numbered, single_pushes
from zfall.evaluation.results import Result
from zfall.evaluation.statistics import head
from zfall.evaluation.writers import Written, write_table
from zfall.falling.kneel_outcomes import (
    PEAKS,
    compare_falls,
    outcome_table,
    summarize_kneel,
    torso_or_head,
)
from zfall.falling.modes import ModeMachine
from zfall.terminal import Sheet

SMALL = 0.55  # pushes of the list up to it are to be recovered from
LARGE = 1.5  # up to it, they are to end in a kneel


class Kneel:
    """A grid of directions x sizes x starts, and ``listed`` forces; one push in each trial.

    Nobody gets up: a mode machine with ``rise`` keeps the robot where it came to rest.
    """

    independent: ClassVar[bool] = True
    baseline_task: ClassVar[str] = "push_to_kneel"
    study_figures: ClassVar[Figures] = {
        "recovered": ("recovered, small pushes", 3),
        "kneeled": ("kneeled, I = 1 to 1.5", 3),
        "clean": ("clean", 3),
        "untouched": ("untouched", 3),
        "kneeled_beyond": ("kneeled, larger", 3),
        "base_acceleration": ("acceleration [m/s2]", 0),
        "torso_head_force": ("force on torso, head [N]", 0),
        "control_falls": ("falls without a push", 1),
    }
    needs_training_size: ClassVar[bool] = False

    pushes = staticmethod(single_pushes)

    def check(self, battery: Battery) -> None:
        """One push point and duration, and no random pushes."""
        check_unused(battery, "resolution", "interval", "commands")
        check_single(battery, "duration", "point")

    def plan(self, battery: Battery, impulse_unit: float, seed: int) -> pd.DataFrame:
        """The grid, then the forces of the list, which ``listed`` tells."""
        headings = [2 * np.pi * d / battery.directions for d in range(battery.directions)]
        rows = cells(battery, headings)
        grid = len(rows)
        for x, y in battery.forces:
            size = float(np.hypot(x, y)) * battery.durations[0] / impulse_unit
            force = {"direction_rad": float(np.arctan2(y, x)), "impulse": size}
            where = {"duration_s": battery.durations[0], "body": battery.points[0]}
            rows += [force | where] * battery.force_starts
        trials = numbered(rows, impulse_unit, seed)
        trials["listed"] = trials["trial"] >= grid
        return trials

    def prepare(self, battery: Battery, trials: pd.DataFrame, env: TransformedEnv) -> None:
        """Takes RISE out of the mode machine."""
        for transform in env.transform:
            if isinstance(transform, ModeMachine):
                transform.rule = replace(transform.rule, rise=None)

    def columns(self, pushes: Pushes, outcomes: Outcomes) -> Mapping[str, NDArray[np.generic]]:
        """None: those of ``Kneeling`` are measured in every battery."""
        return {}

    def background(self, battery: Battery) -> Battery | None:
        """None."""
        return None

    def summary(self, battery: Battery, trials: pd.DataFrame) -> dict[str, Any]:
        """Outcomes by impulse, by direction, and by force of the list."""
        return head(battery, trials) | summarize_kneel(trials)

    def write(self, result: Result, folder: Path) -> Written:
        """The table of outcomes, and mean peaks over all falls of the grid."""
        summary = result.summary
        rows = outcome_table(summary)
        values = {peak: summary[f"grid_falls_{peak}_mean"] for peak in PEAKS}
        means = ", ".join(f"{k} {v:.3g}" for k, v in values.items() if v is not None)
        return Written(
            write_table(folder, "outcomes", rows),
            [
                Sheet(rows, file=str(folder / "outcomes.csv")),
                f"means over {summary['grid_falls']} falls: {means}",
            ],
        )

    def compare(self, results: Mapping[str, Result], folder: Path) -> Written:
        """The outcomes of all, and how hard they fall where all fall."""
        tables = [outcome_table(result.summary) for result in results.values()]
        outcomes = pd.concat(tables, keys=list(results)).reset_index(0, names="run")
        falls = compare_falls({label: result.trials for label, result in results.items()})
        return Written(
            write_table(folder, "outcomes", outcomes) + write_table(folder, "falls", falls)
        )

    def study_row(
        self, battery: Battery, trials: pd.DataFrame, training_size: str
    ) -> dict[str, float]:
        """``study_figures``; NaN where there is nothing to count.

        Of the pushes up to I = 1.5 that were not recovered from: ``kneeled``, ``untouched`` (torso
        and head never on the floor) and, of the kneels, ``clean``. ``kneeled_beyond``: of larger
        ones. Peaks are means over all falls on the grid, which nobody recovers from: whoever gives
        up after small pushes must not gain by that.
        """
        pushed = trials[trials["impulse"] > 0]
        small = pushed[pushed["listed"] & (pushed["impulse"] < SMALL)]
        fallen = pushed[~pushed["recovered"] & ~pushed["listed"]]
        near, beyond = fallen[fallen["impulse"] <= LARGE], fallen[fallen["impulse"] > LARGE]
        force = fallen[["peak_contact_force/torso", "peak_contact_force/head"]].max(axis=1)
        values = {
            "recovered": small["recovered"],
            "kneeled": near["kneeled"],
            "clean": ~torso_or_head(near[near["kneeled"].astype(bool)]),
            "untouched": ~torso_or_head(near),
            "kneeled_beyond": beyond["kneeled"],
            "base_acceleration": fallen["peak_base_acceleration"],
            "torso_head_force": force,
        }
        means = {name: float(column.astype(float).mean()) for name, column in values.items()}
        return means | {"control_falls": int(trials["fell"][trials["impulse"] == 0].sum())}
