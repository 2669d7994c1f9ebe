"""Walking as commanded: how near a robot comes to the speeds and turns that it is given."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from torchrl.envs import TransformedEnv

from zfall.envs.transforms.commands import ENTRIES, Command
from zfall.evaluation.definitions import Battery, check_single, check_unused
from zfall.evaluation.kinds import Figures
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import Pushes, numbered, pushes_along
from zfall.evaluation.results import Result
from zfall.evaluation.statistics import head
from zfall.evaluation.writers import Written, write_table
from zfall.terminal import Sheet

GIVEN = ("vx", "vy", "yaw")  # what a battery's commands give of a command
ERRORS = ("velocity_error", "yaw_rate_error", "heading_error")
MEANS = ("velocity_forward", "velocity_left", "yaw_rate", *ERRORS)


class Walking:
    """Commands x starts, nobody pushes; the measure ``CommandFollowing`` gives its figures."""

    independent: ClassVar[bool] = True
    baseline_task: ClassVar[str] = "walk"
    study_figures: ClassVar[Figures] = {
        "velocity_error": ("velocity error [m/s]", 3),
        "yaw_rate_error": ("yaw rate error [rad/s]", 3),
        "heading_error": ("heading error [rad]", 2),
        "control_falls": ("falls", 1),
    }
    needs_training_size: ClassVar[bool] = False

    def check(self, battery: Battery) -> None:
        """At least one command, and no pushes."""
        check_unused(battery, "resolution", "interval", "forces")
        check_single(battery, "duration", "point")
        if not battery.commands:
            raise ValueError("battery.commands must hold at least one [vx, vy, yaw rate], got [].")

    def plan(self, battery: Battery, impulse_unit: float, seed: int) -> pd.DataFrame:
        """Rows without a push, with columns ``command_vx``, ``command_vy``, ``command_yaw``."""
        rows = [
            {
                "direction_rad": np.nan,
                "impulse": 0.0,
                "duration_s": battery.durations[0],
                "body": battery.points[0],
                **{f"command_{name}": x for name, x in zip(GIVEN, command, strict=True)},
            }
            for command in battery.commands
            for _ in range(battery.starts)
        ]
        return numbered(rows, impulse_unit, seed)

    def pushes(self, battery: Battery, trials: pd.DataFrame) -> Pushes:
        """None that ever begins."""
        never = torch.full((len(trials), 1), torch.inf, dtype=torch.float64)
        return pushes_along(battery, trials, never, torch.zeros(len(trials), 1, 3))

    def prepare(self, battery: Battery, trials: pd.DataFrame, env: TransformedEnv) -> None:
        """Gives each world the command of its trial.

        Raises:
            ValueError: if the env has no transform that is given commands.
        """
        given = [transform for transform in env.transform if isinstance(transform, Command)]
        if not given:
            raise ValueError(
                f"run must be a policy that is given commands for battery {battery.name}, but its "
                "env has no transform Command: env=walk has one."
            )
        command = torch.zeros(len(trials), len(ENTRIES))
        for name in GIVEN:
            column = trials[f"command_{name}"].to_numpy(dtype=float)
            command[:, ENTRIES.index(name)] = torch.tensor(column).float()
        for transform in given:
            transform.give(command)

    def columns(self, pushes: Pushes, outcomes: Outcomes) -> Mapping[str, NDArray[np.generic]]:
        """None: those of ``CommandFollowing`` are a measure."""
        return {}

    def background(self, battery: Battery) -> Battery | None:
        """None."""
        return None

    def summary(self, battery: Battery, trials: pd.DataFrame) -> dict[str, Any]:
        """Mean errors over all trials, and means by command."""
        means = {name: float(trials[name].mean()) for name in ERRORS}
        return (
            head(battery, trials) | means | {"commands": command_table(trials).to_dict("records")}
        )

    def write(self, result: Result, folder: Path) -> Written:
        """Means by command, as a table."""
        rows = command_table(result.trials)
        shown = Sheet(rows, file=str(folder / "commands.csv"))
        return Written(write_table(folder, "commands", rows), [shown])

    def compare(self, results: Mapping[str, Result], folder: Path) -> Written:
        """Nothing besides ``comparison.csv``."""
        return Written()

    def study_row(
        self, battery: Battery, trials: pd.DataFrame, training_size: str
    ) -> dict[str, float]:
        """``study_figures``."""
        summary = self.summary(battery, trials)
        return {key: float(summary[key]) for key in self.study_figures}


def command_table(trials: pd.DataFrame) -> pd.DataFrame:
    """Means over the trials of each command.

    ``command_vx``, ``command_vy`` [m/s], ``command_yaw`` [rad/s], ``trials``, their number, and
    ``fell``, how many of them fell; then the means of ``CommandFollowing``.
    """
    keys = [f"command_{name}" for name in GIVEN]
    groups = trials.groupby(keys, sort=False)
    table: pd.DataFrame = groups[list(MEANS)].mean()
    table.insert(0, "trials", groups.size())
    table.insert(1, "fell", groups["fell"].sum())
    return table.reset_index()
