"""The kind of battery ``get_up``: from where a robot lies or kneels, how soon it stands."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from torchrl.envs import TransformedEnv

from zfall.envs.transforms.starts import ScriptedStart
from zfall.evaluation.definitions import Battery, check_single, check_unused
from zfall.evaluation.kinds import Figures
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import Pushes, numbered, single_pushes
from zfall.evaluation.results import Result
from zfall.evaluation.statistics import head, wilson
from zfall.evaluation.writers import Written, write_table
from zfall.falling.lying import POSTURES, load_lying
from zfall.falling.modes import STABLE, ModeMachine
from zfall.terminal import Sheet

TIMES = (5.0, 8.0)  # in which a robot is to stand [s]


class GetUp:
    """Postures x ``starts``: each trial begins in a state of the robot's bank, in mode STABLE.

    Nothing pushes. The time counts from there; with modes, the robot first rests for ``rise``.
    """

    independent: ClassVar[bool] = True
    baseline_task: ClassVar[str] = "push_to_stand"
    study_figures: ClassVar[Figures] = {
        **{f"kneel_{t:g}": (f"from a kneel in {t:g} s", 3) for t in TIMES},
        **{f"lying_{t:g}": (f"from lying in {t:g} s", 3) for t in TIMES},
    }
    needs_training_size: ClassVar[bool] = False

    pushes = staticmethod(single_pushes)

    def check(self, battery: Battery) -> None:
        """One push point and duration, of pushes that there are not, and no lists."""
        check_unused(battery, "resolution", "interval", "forces", "commands", "aftermath")
        check_single(battery, "duration", "point")

    def plan(self, battery: Battery, impulse_unit: float, seed: int) -> pd.DataFrame:
        """A row for each posture and start; ``start`` says which."""
        row: dict[str, Any] = {"direction_rad": 0.0, "impulse": 0.0}
        row |= {"duration_s": battery.durations[0], "body": battery.points[0]}
        trials = numbered([row] * (battery.starts * len(POSTURES)), impulse_unit, seed)
        trials["start"] = np.repeat(POSTURES, battery.starts)
        return trials

    def prepare(self, battery: Battery, trials: pd.DataFrame, env: TransformedEnv) -> None:
        """Puts every world into the state of its trial, and its mode machine into STABLE."""
        bank = load_lying(env.base_env.robot)
        numbers = trials["trial"].to_numpy() % battery.starts
        postures = [POSTURES.index(start) for start in trials["start"]]
        rows = []
        for posture, number in zip(postures, numbers.tolist(), strict=True):
            there = (bank["posture"] == posture).nonzero()[:, 0]
            rows.append(int(there[number % len(there)]))
        states = {key: bank[key][torch.tensor(rows)] for key in bank if key != "posture"}
        for transform in env.transform:
            if isinstance(transform, ScriptedStart):
                transform.states = states
            if isinstance(transform, ModeMachine):
                transform.initial = STABLE

    def columns(self, pushes: Pushes, outcomes: Outcomes) -> Mapping[str, NDArray[np.generic]]:
        """None: those of ``Rising`` are measured."""
        return {}

    def background(self, battery: Battery) -> Battery | None:
        """None."""
        return None

    def summary(self, battery: Battery, trials: pd.DataFrame) -> dict[str, Any]:
        """By posture, and of all that lie: who stands in time, with Wilson 95 % intervals."""
        groups = {name: trials[trials["start"] == name] for name in POSTURES}
        groups["lying"] = trials[trials["start"] != "kneel"]
        return head(battery, trials) | {"get_up": {k: _figures(v) for k, v in groups.items()}}

    def write(self, result: Result, folder: Path) -> Written:
        """The table of the summary."""
        rows = get_up_table(result.summary)
        return Written(
            write_table(folder, "get_up", rows), [Sheet(rows, file=str(folder / "get_up.csv"))]
        )

    def compare(self, results: Mapping[str, Result], folder: Path) -> Written:
        """The tables of all."""
        tables = [get_up_table(result.summary) for result in results.values()]
        rows = pd.concat(tables, keys=list(results)).reset_index(0, names="run")
        return Written(write_table(folder, "get_up", rows))

    def study_row(
        self, battery: Battery, trials: pd.DataFrame, training_size: str
    ) -> dict[str, float]:
        """``study_figures``."""
        groups = self.summary(battery, trials)["get_up"]
        return {
            f"{name}_{time:g}": groups[name][f"within_{time:g}"]
            for name in ("kneel", "lying")
            for time in TIMES
        }


def _figures(trials: pd.DataFrame) -> dict[str, Any]:
    """``n``, shares with their intervals, and the median time of those that stood [s]."""
    count = len(trials)
    counts = {f"within_{time:g}": int((trials["stood_s"] <= time).sum()) for time in TIMES}
    counts["stands_at_the_end"] = int(trials["stood"].sum())
    out: dict[str, Any] = {"n": count}
    for name, successes in counts.items():
        out[name] = successes / count
        out[f"{name}_low"], out[f"{name}_high"] = wilson(successes, count)
    median = float(trials["stood_s"].median())
    return out | {
        "median_s": None if np.isnan(median) else median,
        "peak_contact_force_mean": float(trials["peak_contact_force"].mean()),
        "peak_joint_torque_mean": float(trials["peak_joint_torque"].mean()),
    }


def get_up_table(summary: Mapping[str, Any]) -> pd.DataFrame:
    """One row per posture: shares in percent with their intervals."""
    rows = []
    for start, entry in summary["get_up"].items():
        row: dict[str, Any] = {"start": start, "n": entry["n"]}
        for key in (*(f"within_{time:g}" for time in TIMES), "stands_at_the_end"):
            share, low, high = (100 * entry[f"{key}{end}"] for end in ("", "_low", "_high"))
            row[key] = f"{share:.0f} % [{low:.0f}, {high:.0f}]"
        median = entry["median_s"]
        row["median [s]"] = "-" if median is None else f"{median:.1f}"
        row["force [N]"] = f"{entry['peak_contact_force_mean']:.0f}"
        row["torque [N m]"] = f"{entry['peak_joint_torque_mean']:.1f}"
        rows.append(row)
    return pd.DataFrame(rows)
