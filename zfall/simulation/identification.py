"""Values of a servo from logs of what it was sent and what it did, with 95 % intervals."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student_t

from zfall.robots.servos import Servo
from zfall.robots.servos.logs import ServoLog
from zfall.simulation.bench import LateServo, run_bench

Array = NDArray[np.float64]

CONFIDENCE = 0.95
# Errors of the fit that lie further apart do not go together [s]: the second, or in short logs as
# little as the first, so that there are about 24 blocks.
BLOCK = (0.5, 1.0)
# Half of an interval up to which a value is determined: a share of it, or, of those that may be
# zero, of the value at which the fit begins.
NARROW, NARROW_AT_ZERO = 0.2, 0.3
OF_PHYSICS = 1e-3  # what a physics step of 2 ms may add to half of an interval, as a share


@dataclass(frozen=True)
class _Unknown:
    """A value that a fit looks for: its unit, and bounds in units of the starting value."""

    unit: str
    low: float = 0.1
    high: float = 10.0


# In the order in which they are given up: sheets know the first best, the last not at all.
_UNKNOWNS = {
    "stall_torque": _Unknown("N m"),
    "no_load_speed": _Unknown("rad/s"),
    "duty_per_radian": _Unknown("1/rad"),
    "backlash": _Unknown("rad", low=0.0),
    "armature": _Unknown("kg m2"),
    "friction": _Unknown("N m", low=0.0, high=20.0),
    "latency": _Unknown("s", low=0.0),
}
NAMES = tuple(_UNKNOWNS)

# Derivatives are taken along changes that may have no effect at all, in place of those of a value
# alone, so that they are then exactly nothing: of the torque limit, where the servo never reaches
# it, and of all torques and inertias, where no load is known. Value: powers of others.
_TOGETHER = {
    "stall_torque": {"stall_torque": 1, "no_load_speed": 1, "duty_per_radian": -1},
    "armature": {"stall_torque": 1, "armature": 1, "friction": 1},
}


@dataclass(frozen=True)
class Estimate:
    """A value and what the logs say of it.

    Args:
        name: of the value.
        unit: its unit.
        value: the fitted one; where the logs do not determine it that of the sheet.
        low: lower end of the 95 % interval.
        high: upper end.
        sheet: value of the sheet, at which the fit began; ``None`` if it has none.
        determined: whether the interval is narrow, see ``NARROW``.
        given: values of the sheet without which the logs do not determine this one.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    sheet: float | None
    determined: bool
    given: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """What the logs say of the value, in words."""
        if not self.determined:
            whose = "kept from the sheet" if self.sheet is not None else "a guess"
            return f"not determined: {whose}"
        return f"determined, given {', '.join(self.given)}" if self.given else "determined"


@dataclass(frozen=True)
class Identification:
    """What came out of a fit.

    Args:
        unit: the servo with the fitted values, and its latency.
        estimates: of each value.
        positions: of the fitted servo, for each log ``(T,)`` [rad].
    """

    unit: LateServo
    estimates: tuple[Estimate, ...]
    positions: tuple[Array, ...]

    def rms(self, logs: Sequence[ServoLog]) -> list[float]:
        """Root of the mean square of the error in each log [rad]."""
        each = zip(self.positions, logs, strict=True)
        return [float(np.sqrt(np.mean((x - log.position) ** 2))) for x, log in each]


def identify(
    logs: Sequence[ServoLog], sheet: Servo, *, physics_dt: float = 0.002
) -> Identification:
    """Fits a servo to logs by least squares of the position.

    The intervals are those of a regression whose errors go together within blocks of ``BLOCK``, as
    those of an encoder do where the shaft hardly moves::

        C = H^-1 (sum_blocks g g^T) H^-1,  H = J^T J,  g = J_block^T r_block

    or, where that is wider, those of independent errors with at least the variance of the
    encoder's steps. ``OF_PHYSICS`` comes on top.

    A value whose interval is wide (``NARROW``) is not determined. The first of them in the order
    of ``NAMES`` then keeps the sheet's value, and the others are fitted again: without a known
    load, for instance, logs determine friction and armature as shares of the stall torque alone.

    Args:
        logs: of one servo.
        sheet: where the fit begins; its ``kp`` is that of the logs.
        physics_dt: longest physics step [s].

    Raises:
        ValueError: if a log's voltage lies outside of the sheet's.

    Source: the covariance is that of Liang and Zeger, "Longitudinal data analysis using generalized
    linear models", Biometrika 1986, with the factor m / (m - p) for m blocks and p values.
    """
    for log in logs:
        for voltage in (log.voltage.min(), log.voltage.max()):
            try:
                sheet.stiffness(float(voltage))
            except ValueError as error:
                raise ValueError(f"{log.name}: {error}") from error
    problem = _Problem(logs, sheet, physics_dt)
    point, free, kept = np.ones(len(NAMES)), list(NAMES), []
    passes: list[tuple[Array, dict[str, float]]] = []  # with less and less values free
    given: dict[str, float] = {}  # half of the interval of each value that was once found wide
    while free:
        point = problem.solve(point, free)
        half = problem.half_widths(point, free)
        passes.append((point, half))
        wide = [name for name in free if not _is_narrow(name, point, half[name])]
        given = {name: half[name] for name in wide} | given
        if not wide:
            break
        kept.append(wide[0])
        free.remove(wide[0])
        point = point.copy()
        point[NAMES.index(wide[0])] = 1.0
    estimates = []
    for i, (name, start) in enumerate(zip(NAMES, problem.scale, strict=True)):
        if name not in free:
            width = given[name]
        elif name in given:
            width = passes[-1][1][name]
        else:  # of the others it needs none: what they are kept at may not make it surer
            width = max(half[name] for _, half in passes) + abs(point[i] - passes[0][0][i])
        estimates.append(
            Estimate(
                name,
                _UNKNOWNS[name].unit,
                value=float(point[i] * start),
                low=float(max(point[i] - width, 0.0) * start),
                high=float((point[i] + width) * start),
                sheet=getattr(sheet, name, None),
                determined=name in free,
                given=tuple(kept) if name in free and name in given else (),
            )
        )
    fitted = problem.unit(point)
    positions = tuple(run_bench([fitted], log, physics_dt=physics_dt)[0] for log in logs)
    return Identification(fitted, tuple(estimates), positions)


def _is_narrow(name: str, point: Array, half: float) -> bool:
    at_zero = NARROW_AT_ZERO if _UNKNOWNS[name].low == 0.0 else 0.0
    return bool(half <= max(NARROW * point[NAMES.index(name)], at_zero))


class _Problem:
    """The position of a bench as a function of a servo's values, in units of starting values."""

    def __init__(self, logs: Sequence[ServoLog], sheet: Servo, physics_dt: float):
        self.logs, self.physics_dt = logs, physics_dt
        # Of no effect here, and maybe more than the damping that is fitted.
        self.sheet = replace(sheet, viscous_friction=None)
        starts = {
            "stall_torque": sheet.stall_torque,
            "no_load_speed": sheet.no_load_speed,
            "duty_per_radian": sheet.duty_per_radian,
            "backlash": sheet.backlash or 0.01,
            "armature": sheet.armature or 0.05 * sheet.damping,
            "friction": sheet.friction or 0.02 * sheet.stall_torque,
            "latency": 0.01,
        }
        self.scale = np.array([starts[name] for name in NAMES])
        seconds = float(np.clip(sum(log.time[-1] for log in logs) / 24, *BLOCK))
        first = np.cumsum([0, *(log.time[-1] // seconds + 1 for log in logs)])
        blocks = [k + log.time // seconds for k, log in zip(first, logs, strict=False)]
        self.block = np.concatenate(blocks).astype(int)
        self.num_blocks = int(first[-1])

    def unit(self, point: Array) -> LateServo:
        """The servo at a point ``(P,)``."""
        values = dict(zip(NAMES, (point * self.scale).tolist(), strict=True))
        latency = values.pop("latency")
        return LateServo(servo=replace(self.sheet, **values), latency=latency)

    def errors(self, points: Array) -> Array:
        """Of the positions at points ``(N, P)``, all rows of all logs ``(N, R)``.

        In standard deviations of the encoder's rounding, ``resolution / sqrt(12)``.
        """
        units = [self.unit(point) for point in points]
        noise = self.sheet.resolution / math.sqrt(12)
        runs = [
            run_bench(units, log, physics_dt=self.physics_dt) - log.position for log in self.logs
        ]
        return np.concatenate(runs, axis=1) / noise

    def solve(self, point: Array, free: Sequence[str]) -> Array:
        """The point of least squares, where all but the free values stay."""
        at = [NAMES.index(name) for name in free]

        def whole(x: Array) -> Array:
            out = point.copy()
            out[at] = x
            return out

        low, high = ([getattr(_UNKNOWNS[name], end) for name in free] for end in ("low", "high"))
        fit = least_squares(
            lambda x: self.errors(whole(x)[None])[0],
            np.clip(point[at], low, high),
            jac=lambda x: self.slopes(whole(x), at),
            bounds=(low, high),
            x_scale="jac",
            xtol=1e-6,
            ftol=1e-6,
        )
        return whole(fit.x)

    def slopes(self, point: Array, at: Sequence[int], step: float = 1e-3) -> Array:
        """Derivatives of the errors by some of the values ``(R, len(at))``, by differences."""
        moved, directions = point + step * np.eye(len(point)), np.eye(len(point))
        for name, powers in _TOGETHER.items():
            changed = [NAMES.index(other) for other in powers]
            if set(changed) <= set(at):
                row = NAMES.index(name)
                moved[row], directions[row] = point, 0.0
                moved[row, changed] *= (1.0 + step) ** np.array([*powers.values()])
                directions[row, changed] = point[changed] * [*powers.values()]
        errors = self.errors(np.concatenate([point[None], moved[at]]))
        along = (errors[1:] - errors[0]).T / step
        return along @ np.linalg.inv(directions[np.ix_(at, at)]).T

    def half_widths(self, point: Array, free: Sequence[str]) -> dict[str, float]:
        """Half of the 95 % interval of each free value, see ``identify``."""
        at = [NAMES.index(name) for name in free]
        step = 1e-3
        ahead, behind = (self.slopes(point, at, sign * step) for sign in (1, -1))
        slopes, errors = (ahead + behind) / 2, self.errors(point[None])[0]
        # What has no effect is then as good as unknown.
        weak = 1e-13 * np.trace(slopes.T @ slopes) * np.eye(len(at))
        inverse = np.linalg.inv(slopes.T @ slopes + weak)
        gradients = np.zeros((self.num_blocks, len(at)))
        np.add.at(gradients, self.block, slopes * errors[:, None])
        freedom = max(self.num_blocks - len(at), 1)
        together = self.num_blocks / freedom * inverse @ gradients.T @ gradients @ inverse
        alone = max(1.0, float(errors @ errors) / (len(errors) - len(at))) * inverse
        variance = np.maximum(np.diag(together), np.diag(alone))
        widths = student_t.ppf((1 + CONFIDENCE) / 2, freedom) * np.sqrt(variance)
        return dict(zip(free, (widths + OF_PHYSICS * point[at]).tolist(), strict=True))
