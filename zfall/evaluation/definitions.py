"""What the batteries try: their definitions, trials and pushes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np
import pandas as pd
import torch
import yaml
from numpy.typing import NDArray
from torch import Tensor

TICK = 0.04  # at which a battery with random pushes draws whether one begins [s]


@dataclass(frozen=True, kw_only=True)
class Battery:
    """Definition of a battery; the fields are explained in ``batteries.yaml``."""

    version: int
    name: str
    point: str | tuple[str, ...]
    directions: int
    impulses: tuple[float, ...]
    starts: int
    start_noise: float
    push_time: float
    duration: float | tuple[float, ...]
    end_time: float
    aftermath: float | None
    max_tilt: float
    min_height: float
    foot_friction: float | None
    mass_factor: tuple[float, float] | None
    load: tuple[float, float] | None
    resolution: float | None
    interval: float | None
    forces: tuple[tuple[float, float], ...]
    force_starts: int

    @property
    def points(self) -> tuple[str, ...]:
        """Where it pushes."""
        return (self.point,) if isinstance(self.point, str) else self.point

    @property
    def durations(self) -> tuple[float, ...]:
        """How long [s]."""
        return self.duration if isinstance(self.duration, tuple) else (self.duration,)


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

    def sooner(self, control_dt: float, physics_dt: float, seed: int) -> "Pushes":
        """The same, each begun sooner by less than a control step, whole physics steps [s].

        A push does not wait for a control step to begin. Who learns from pushes that all begin
        with one has met none that is half a step old when it is first seen.
        """
        steps = np.random.default_rng(seed).integers(
            round(control_dt / physics_dt), size=self.time.shape
        )
        return replace(self, time=self.time - physics_dt * torch.tensor(steps))


_WHOLE = ("a whole number", lambda value: type(value) is int)
_NUMBER = ("a number", lambda value: type(value) in (int, float))
_NUMBERS = ("a list of numbers, [0.2,0.4]", lambda value: _all(value, _NUMBER[1]))
_KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    **dict.fromkeys(("directions", "starts", "force_starts"), _WHOLE),
    **dict.fromkeys(("end_time", "resolution"), _NUMBER),
    "impulses": _NUMBERS,
    "duration": (
        "a number or a list of numbers",
        lambda value: _NUMBER[1](value) or _NUMBERS[1](value),
    ),
}


def _all(values: Any, fits: Callable[[Any], bool]) -> bool:
    return not isinstance(values, str) and isinstance(values, Sequence) and all(map(fits, values))


def _fits(key: str, value: Any) -> bool:
    return key not in _KINDS or _KINDS[key][1](value)


def load_battery(name: str, **options: Any) -> Battery:
    """A battery by name, with some of its numbers replaced.

    Raises:
        ValueError: if there is no such battery or no such option.
    """
    table = yaml.safe_load(files("zfall.evaluation").joinpath("batteries.yaml").read_text())
    version = table.pop("battery_version")
    if name not in table:
        raise ValueError(f"battery must be one of {', '.join(table)}, got {name!r}.")
    unknown = sorted(set(options) - set(table[name]))
    if unknown:
        raise ValueError(
            f"options of battery {name} are {', '.join(table[name])}, got {unknown[0]}."
        )
    for key, value in options.items():
        if not _fits(key, value):
            raise ValueError(f"{key} must be {_KINDS[key][0]}, got {value}.")
    numbers = table[name] | options
    numbers["impulses"] = tuple(float(impulse) for impulse in numbers["impulses"])
    if not numbers["impulses"] or min(numbers["impulses"]) <= 0:
        raise ValueError(f"impulses must be positive, at least one, got {numbers['impulses']}.")
    points = numbers["point"]
    if isinstance(points, (int, float)) or not points:
        raise ValueError(f"point must be a name, or a list of at least one, got {points}.")
    if not isinstance(points, str):
        numbers["point"] = tuple(numbers["point"])
    if not isinstance(numbers["duration"], (int, float)):
        numbers["duration"] = tuple(numbers["duration"])
    numbers["forces"] = tuple(tuple(force) for force in numbers["forces"])
    resolution = numbers["resolution"]
    if resolution is not None and not 0 < resolution < max(numbers["impulses"]):
        raise ValueError(
            f"resolution must lie between 0 and the largest of impulses, got {resolution}."
        )
    if resolution is not None and (numbers["interval"] is not None or numbers["forces"]):
        raise ValueError(f"resolution must be null: the pushes of {name} are given or random.")
    for key in ("mass_factor", "load"):
        numbers[key] = None if numbers[key] is None else tuple(numbers[key])
    for key in ("directions", "starts"):
        if numbers[key] < 1:
            raise ValueError(f"{key} must be at least 1, got {numbers[key]}.")
    single = {"duration"} if resolution is not None else {"duration", "point"}
    for key in sorted(single if numbers["interval"] is None else ()):
        if isinstance(numbers[key], tuple):
            raise ValueError(f"{key} of battery {name} must be one, got {numbers[key]}.")
    battery = Battery(version=version, name=name, **numbers)
    if min(battery.durations, default=0.0) <= 0:
        raise ValueError(f"duration must be positive, got {numbers['duration']}.")
    over = battery.push_time + max(battery.durations)
    if not battery.end_time > over:
        raise ValueError(
            f"end_time must be later than the end of the push, {over:g} s, got {battery.end_time}."
        )
    return battery


def plan_trials(battery: Battery, impulse_unit: float, seed: int) -> pd.DataFrame:
    """One row per trial: push point x duration x impulse x direction x start; a control arm.

    The control arm, of impulse 0, comes first; forces that the battery lists come last. Where
    pushes are random (``interval``) a row has no direction.

    Args:
        battery: the definition.
        impulse_unit: impulse of dimensionless size 1 of the robot [N s].
        seed: of the battery; a trial's own randomness comes from ``[seed, trial]``.
    """
    cells = [(0.0, battery.points[0], battery.durations[0])]
    cells += [
        (i, p, d) for p in battery.points for d in battery.durations for i in battery.impulses
    ]
    headings = [2 * np.pi * d / battery.directions for d in range(battery.directions)]
    if battery.interval is not None:
        headings = [np.nan]
    rows = [
        {"direction_rad": heading, "impulse": size, "duration_s": duration, "body": point}
        for size, point, duration in cells
        for heading in headings
        for _ in range(battery.starts)
    ]
    for x, y in battery.forces:
        size = float(np.hypot(x, y)) * battery.durations[0] / impulse_unit
        listed = {"direction_rad": float(np.arctan2(y, x)), "impulse": size}
        where = {"duration_s": battery.durations[0], "body": battery.points[0]}
        rows += [listed | where] * battery.force_starts
    trials = pd.DataFrame(rows)
    trials.insert(0, "trial", range(len(trials)))
    trials.insert(4, "force_n", trials["impulse"] * impulse_unit / trials["duration_s"])
    trials["seed"] = seed
    if battery.forces:
        grid = len(trials) - len(battery.forces) * battery.force_starts
        trials["listed"] = trials["trial"] >= grid
    return trials


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


def plan_pushes(battery: Battery, trials: pd.DataFrame) -> Pushes:
    """The pushes of trials, which have the columns of ``plan_trials``."""
    points = torch.tensor([battery.points.index(body) for body in trials["body"]])
    duration = torch.tensor(trials["duration_s"].to_numpy(dtype=float))[:, None]
    force = torch.tensor(trials["force_n"].to_numpy(dtype=float))[:, None]
    if battery.interval is None:
        heading = torch.tensor(trials["direction_rad"].to_numpy(dtype=float))
        unit = torch.stack([heading.cos(), heading.sin(), 0 * heading], -1)[:, None]
        time = torch.full_like(force, battery.push_time)
    else:
        drawn = [
            _random_pushes(battery, length, seed, trial)
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
    return Pushes(
        time,
        (force[..., None] * unit).float(),
        duration.expand_as(time).clone(),
        points[:, None].expand_as(time).clone(),
    )


def _random_pushes(
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
