"""What a servo on a bench was sent and what it did, read from a csv file."""

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]

COLUMNS = ("time_s", "target_rad", "position_rad")
VOLTAGE = "voltage_v"
LEAST_ROWS = 100
LONGEST_STEP = 0.05  # between rows [s]
LEAST_MOTION = 0.05  # of target and position, from end to end [rad]
LARGEST_ANGLE = 4 * math.pi  # beyond it the numbers are degrees, or steps of the encoder
MOTION_AT_REST = 0.02  # within the first rows [rad]
ROWS_AT_REST = 5


@dataclass(frozen=True, kw_only=True)
class Load:
    """What turns with a shaft: a point mass on an arm, and inertia that gravity does not feel.

    Args:
        mass: at the end of the arm [kg].
        arm: from the shaft to the mass [m].
        inertia: about the shaft, in addition to ``mass arm^2`` [kg m2].
        down: angle at which the arm hangs straight down [rad].

    Raises:
        ValueError: if a value is negative or not finite, or a mass has no arm.
    """

    mass: float = 0.0
    arm: float = 0.0
    inertia: float = 0.0
    down: float = 0.0

    def __post_init__(self) -> None:
        for name in ("mass", "arm", "inertia"):
            if not 0 <= (value := getattr(self, name)) < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {value}.")
        if self.mass and not self.arm:
            raise ValueError(f"arm must be positive for a mass of {self.mass:g} kg, got 0.")
        if not math.isfinite(self.down):
            raise ValueError(f"down must be finite, got {self.down}.")


@dataclass(frozen=True, kw_only=True)
class ServoLog:
    """What a servo was sent, each row until the next, and where it was at that time.

    Args:
        name: for messages and plots.
        time: rising, from 0 ``(T,)`` [s].
        target: ``(T,)`` [rad].
        position: ``(T,)`` [rad].
        voltage: of the supply ``(T,)`` [V].
        load: on the shaft.
    """

    name: str
    time: Array
    target: Array
    position: Array
    voltage: Array
    load: Load = field(default_factory=Load)

    @property
    def start(self) -> float:
        """Position before the first command, in the mean over the rows at rest [rad]."""
        moved = np.flatnonzero(self.target != self.target[0])
        rows = min(int(moved[0]) if len(moved) else len(self.target), ROWS_AT_REST)
        return float(np.mean(self.position[:rows]))


def read_log(path: Path, *, load: Load, voltage: float) -> ServoLog:
    """Reads a log with the columns ``time_s, target_rad, position_rad`` and maybe ``voltage_v``.

    Args:
        path: of the csv file; columns that are not named here are not read.
        load: on the shaft.
        voltage: of the supply, if the log has no such column [V].

    Raises:
        ValueError: if a column is missing, a value is no finite number, the time does not rise,
            rows are missing, or too little moves to fit a servo to; naming the file and the row.
    """
    if not path.is_file():
        raise ValueError(f"log must be a csv file or a list of them, there is no {path}.")
    try:
        table = pd.read_csv(path, skipinitialspace=True)
    except (ValueError, pd.errors.ParserError) as error:
        raise ValueError(f"log must be a csv file, {path} cannot be read: {error}.") from error
    missing = [name for name in COLUMNS if name not in table]
    if missing:
        raise ValueError(
            f"{path} must have the columns {', '.join(COLUMNS)}, lacks {', '.join(missing)}; it "
            f"has {', '.join(map(str, table))}."
        )
    names = [name for name in (*COLUMNS, VOLTAGE) if name in table]
    values = {name: _numbers(path, name, table[name]) for name in names}
    if len(table) < LEAST_ROWS:
        raise ValueError(f"{path} must have at least {LEAST_ROWS} rows, got {len(table)}.")
    time = values["time_s"]
    log = ServoLog(
        name=path.stem,
        time=time - time[0],
        target=values["target_rad"],
        position=values["position_rad"],
        voltage=values.get(VOLTAGE, np.full(len(table), voltage)),
        load=load,
    )
    _check_time(path, time)
    _check_motion(path, log)
    return log


def _numbers(path: Path, name: str, column: "pd.Series[float]") -> Array:
    """The numbers of a column, all finite."""
    values = pd.to_numeric(column, errors="coerce").to_numpy(np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        got = column.iloc[bad[0]]
        raise ValueError(f"{path}: {name} must be finite, got {got} in row {bad[0] + 1}.")
    return values


def _check_time(path: Path, time: Array) -> None:
    """Refuses a time that does not rise, and gaps."""
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        row = int(back[0]) + 1
        raise ValueError(
            f"{path}: time_s must rise from row to row, got {time[row]:g} after {time[row - 1]:g} "
            f"in row {row + 1}."
        )
    gaps = np.flatnonzero(steps > LONGEST_STEP)
    if len(gaps):
        row = int(gaps[0])
        raise ValueError(
            f"{path}: time_s must go on by at most {LONGEST_STEP:g} s from row to row, got a gap "
            f"of {steps[row]:.3g} s after {time[row]:g} s; give the parts as logs of their own."
        )


def _check_motion(path: Path, log: ServoLog) -> None:
    """Refuses angles in other units, a servo at rest, and one that moves from the start."""
    for name, values in (("target_rad", log.target), ("position_rad", log.position)):
        largest = float(np.abs(values).max())
        if largest > LARGEST_ANGLE:
            raise ValueError(
                f"{path}: {name} must be radians within +-{LARGEST_ANGLE:.3g}, got {largest:g}."
            )
        moved = float(np.ptp(values))
        if moved < LEAST_MOTION:
            raise ValueError(
                f"{path}: {name} must move by at least {LEAST_MOTION:g} rad, got {moved:.3g}: "
                "without motion nothing can be fitted."
            )
    begun = float(np.ptp(log.position[:ROWS_AT_REST]))
    if begun > MOTION_AT_REST:
        raise ValueError(
            f"{path}: position_rad must begin at rest, got {begun:.3g} rad of motion in the first "
            f"{ROWS_AT_REST} rows; cut the log to where the servo rests."
        )
