"""What a battery tries: its trials, and the pushes of each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from torch import Tensor

from zfall.evaluation.definitions import Battery
from zfall.evaluation.kinds import kind_of


@dataclass(frozen=True)
class Pushes:
    """E pushes of each of K trials; those that a trial does not have never begin.

    Args:
        time: when they begin ``(K, E)`` [s].
        force: ``(K, E, 3)`` [N; world].
        duration: ``(K, E)`` [s].
        point: where, a position in ``Battery.points`` ``(K, E)``.
    """

    time: Tensor
    force: Tensor
    duration: Tensor
    point: Tensor

    def __getitem__(self, rows: NDArray[np.intp]) -> "Pushes":
        """Those of some of the trials."""
        index = torch.tensor(rows)
        return Pushes(self.time[index], self.force[index], self.duration[index], self.point[index])

    def later(self, spread: float, physics_dt: float, seed: int) -> "Pushes":
        """The same, each begun later by up to ``spread`` seconds, whole physics steps.

        Who learns from pushes that all come at one time learns that time: its memory counts the
        steps since the reset, and it expects the push.
        """
        steps = np.random.default_rng(seed).integers(
            round(spread / physics_dt), size=self.time.shape
        )
        return replace(self, time=self.time + physics_dt * torch.tensor(steps).double())


def plan_trials(battery: Battery, impulse_unit: float, seed: int) -> pd.DataFrame:
    """One row per trial, as the battery's kind plans them.

    Columns: ``trial``, its number; ``direction_rad`` (0 forward, pi/2 to the left; NaN where
    pushes are random); ``impulse``, dimensionless, 0 in the control arm; ``duration_s``;
    ``force_n``; ``body``, the push point; ``seed``; and what a kind adds.

    Args:
        battery: the definition.
        impulse_unit: impulse of dimensionless size 1 of the robot [N s].
        seed: of the battery; a trial's own randomness comes from ``[seed, trial]``.
    """
    return kind_of(battery).plan(battery, impulse_unit, seed)


def plan_pushes(battery: Battery, trials: pd.DataFrame) -> Pushes:
    """The pushes of trials, which have the columns of ``plan_trials``, by the battery's kind."""
    return kind_of(battery).pushes(battery, trials)


def grid(battery: Battery, impulse_unit: float, seed: int) -> pd.DataFrame:
    """Trials: push point x duration x impulse x direction x start.

    The control arm, of impulse 0, comes first.
    """
    headings = [2 * np.pi * d / battery.directions for d in range(battery.directions)]
    return numbered(cells(battery, headings), impulse_unit, seed)


def cells(battery: Battery, headings: Sequence[float]) -> list[dict[str, Any]]:
    """Rows of a plan, those of the control arm first, for some directions [rad]."""
    sizes = [(0.0, battery.points[0], battery.durations[0])]
    sizes += [
        (i, p, d) for p in battery.points for d in battery.durations for i in battery.impulses
    ]
    return [
        {"direction_rad": heading, "impulse": size, "duration_s": duration, "body": point}
        for size, point, duration in sizes
        for heading in headings
        for _ in range(battery.starts)
    ]


def numbered(rows: Sequence[dict[str, Any]], impulse_unit: float, seed: int) -> pd.DataFrame:
    """The plan of these rows: numbers of the trials, their forces and seed are added."""
    trials = pd.DataFrame(rows)
    trials.insert(0, "trial", range(len(trials)))
    trials.insert(4, "force_n", trials["impulse"] * impulse_unit / trials["duration_s"])
    trials["seed"] = seed
    return trials


def single_pushes(battery: Battery, trials: pd.DataFrame) -> Pushes:
    """One level push in each trial, at ``push_time``, in its direction."""
    heading = torch.tensor(trials["direction_rad"].to_numpy(dtype=float))
    unit = torch.stack([heading.cos(), heading.sin(), 0 * heading], -1)[:, None]
    time = torch.full((len(trials), 1), battery.push_time, dtype=torch.float64)
    return pushes_along(battery, trials, time, unit)


def pushes_along(battery: Battery, trials: pd.DataFrame, time: Tensor, unit: Tensor) -> Pushes:
    """Pushes of the trials' forces and durations, at their push points.

    Args:
        battery: the definition.
        trials: the plan.
        time: when they begin ``(K, E)`` [s]; infinite: never.
        unit: vectors along them ``(K, E, 3)``.
    """
    points = torch.tensor([battery.points.index(body) for body in trials["body"]])
    duration = torch.tensor(trials["duration_s"].to_numpy(dtype=float))[:, None]
    force = torch.tensor(trials["force_n"].to_numpy(dtype=float))[:, None]
    return Pushes(
        time,
        (force[..., None] * unit).float(),
        duration.expand_as(time).clone(),
        points[:, None].expand_as(time).clone(),
    )


def those_of(trials: pd.DataFrame, only: Sequence[int] | None) -> pd.DataFrame:
    """The trials of these numbers; all if ``None``.

    Raises:
        ValueError: on a number that none has.
    """
    if only is None:
        return trials
    unknown = sorted(set(only) - set(trials["trial"]))
    if unknown:
        raise ValueError(f"trial must be one of 0 to {len(trials) - 1}, got {unknown[0]}.")
    return trials[trials["trial"].isin(only)]
