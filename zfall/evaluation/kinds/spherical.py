"""Pushes in random directions, one after the other: how many in a row are withstood."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from torch import Tensor

from zfall.evaluation.definitions import Battery, check_unused
from zfall.evaluation.headings import count
from zfall.evaluation.kinds import Figures
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import Pushes, cells, numbered, pushes_along
from zfall.evaluation.plots import withstood_map
from zfall.evaluation.results import Result
from zfall.evaluation.statistics import head, withstood_table
from zfall.evaluation.writers import Written, write_figures, write_table
from zfall.terminal import Sheet

TICK = 0.04  # at which it is drawn whether a push begins [s]


class Spherical:
    """Push points x durations x sizes x episodes; a Bernoulli draw begins each push."""

    independent: ClassVar[bool] = True
    baseline_task: ClassVar[str] = "push_recovery"
    study_figures: ClassVar[Figures] = {
        "withstood_mean": ("pushes withstood in a row", 2),
        "control_falls": ("falls without a push", 1),
    }
    needs_training_size: ClassVar[bool] = False

    def check(self, battery: Battery) -> None:
        """A mean rest between pushes, and no listed ones."""
        check_unused(battery, "resolution", "forces", "commands")
        if battery.interval is None:
            raise ValueError("battery.interval must be a number of seconds, got null.")

    def plan(self, battery: Battery, impulse_unit: float, seed: int) -> pd.DataFrame:
        """Rows without a direction: each push of a trial has its own."""
        return numbered(cells(battery, [np.nan]), impulse_unit, seed)

    def pushes(self, battery: Battery, trials: pd.DataFrame) -> Pushes:
        """Random times and directions, from each trial's own seed."""
        drawn = [
            random_pushes(battery, length, seed, trial)
            for trial, seed, length in zip(
                trials["trial"], trials["seed"], trials["duration_s"], strict=True
            )
        ]
        events = max([1, *(len(times) for times, _ in drawn)])
        time = torch.full((len(trials), events), torch.inf, dtype=torch.float64)
        unit = torch.zeros(len(trials), events, 3, dtype=torch.float64)
        for row, (times, directions) in enumerate(drawn):
            time[row, : len(times)] = torch.tensor(times)
            unit[row, : len(times)] = torch.tensor(directions)
        return pushes_along(battery, trials, time, unit)

    def columns(self, pushes: Pushes, outcomes: Outcomes) -> Mapping[str, NDArray[np.generic]]:
        """``withstood``: pushes in a row."""
        return {"withstood": withstood(pushes.time, outcomes)}

    def background(self, battery: Battery) -> Battery | None:
        """None."""
        return None

    def summary(self, battery: Battery, trials: pd.DataFrame) -> dict[str, Any]:
        """Its ``withstood_table`` and the control arm."""
        return head(battery, trials) | {
            "withstood": withstood_table(trials).to_dict("records"),
            "withstood_mean": float(trials["withstood"][trials["impulse"] > 0].mean()),
        }

    def write(self, result: Result, folder: Path) -> Written:
        """Means by size, duration and push point, as a map and a table."""
        cell = ("body", "duration_s", "impulse")
        title = result.heading(count(result.trials, cell, "episodes per cell"))
        files = write_figures(
            folder, "withstood", lambda path: withstood_map(result.trials, path, title=title)
        )
        rows = pd.DataFrame(result.summary["withstood"])
        return Written(
            files + write_table(folder, "withstood", rows),
            [Sheet(rows, file=str(folder / "withstood.csv"))],
        )

    def compare(self, results: Mapping[str, Result], folder: Path) -> Written:
        """Nothing besides ``comparison.csv``."""
        return Written()

    def study_row(
        self, battery: Battery, trials: pd.DataFrame, training_size: str
    ) -> dict[str, float]:
        """``study_figures``."""
        summary = self.summary(battery, trials)
        return {key: float(summary[key]) for key in self.study_figures}


def random_pushes(
    battery: Battery, duration: float, seed: int, trial: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times ``(E,)`` [s] and unit vectors ``(E, 3)`` of a trial's pushes, any two of them apart.

    At every tick at which none acts one begins with probability ``TICK / interval``; its
    direction is uniform on the sphere.
    """
    generator = np.random.default_rng(np.random.SeedSequence([seed, trial, 2]))
    ticks = round((battery.end_time - battery.push_time) / TICK)
    begins = generator.random(ticks) < TICK / (battery.interval or np.inf)
    directions = generator.standard_normal((ticks, 3))
    times: list[int] = []
    for tick in begins.nonzero()[0].tolist():
        if not times or (tick - times[-1]) * TICK >= duration - 1e-9:
            times.append(tick)
    chosen = directions[times]
    unit = chosen / np.linalg.norm(chosen, axis=1, keepdims=True)
    return battery.push_time + TICK * np.array(times, dtype=float), unit


def withstood(time: Tensor, outcomes: Outcomes) -> NDArray[np.int64]:
    """Pushes in a row that each trial withstood ``(K,)``: those begun, but the one it fell after.

    Args:
        time: when the pushes begin ``(K, E)`` [s].
        outcomes: of at least K worlds.
    """
    fell = outcomes.fell[: len(time)]
    end = outcomes.fall_time[: len(time)].double().nan_to_num(outcomes.battery.end_time)
    begun = (time < end[:, None] - 1e-3).sum(1)  # a step is longer, rounding shorter
    return (begun - fell.long()).clamp_min(0).numpy()
