"""Walks of the linear inverted pendulum: footsteps, feet and center of mass in closed form."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zfall.robots import GRAVITY

Times = NDArray[np.floating]  # [s]
Plane = NDArray[np.complex128]  # points of the floor, x + i y [m]; e^(i a) turns by a


@dataclass(frozen=True, kw_only=True)
class Gait:
    """A steady walk along a straight line, on a circle or on the spot.

    Foot n (even: left) stands from ``n step_time`` to ``(n + 1) step_time``, and half a double
    support longer at either end. A stride, after which everything repeats but for the way made
    good, has two steps and begins when the right foot leaves the floor for the first time.

    Args:
        speed: forward [m/s].
        turn_rate: to the left [rad/s].
        step_time: from one touchdown to the next [s].
        double_support: time of each step with both feet on the floor [s].
        half_width: between the line walked on and the center of a sole [m].
        lift: largest height of the swinging sole [m].
        com_height: height of the center of mass, which is constant [m].

    Raises:
        ValueError: if double support does not leave time to swing.
    """

    speed: float = 0.0
    turn_rate: float = 0.0
    step_time: float
    double_support: float
    half_width: float
    lift: float
    com_height: float

    def __post_init__(self) -> None:
        if not 0 < self.double_support < self.step_time:
            raise ValueError(
                f"double_support must lie between 0 and step_time {self.step_time}, "
                f"got {self.double_support}."
            )

    @property
    def stride(self) -> tuple[float, float]:
        """Beginning and end of a stride [s]."""
        begin = self.double_support / 2
        return begin, begin + 2 * self.step_time

    @property
    def step_length(self) -> float:
        """Way along the line from one footstep to the next [m]."""
        return self.speed * self.step_time


class Feet(NamedTuple):
    """Soles at T times, left and right.

    position: of the center of the sole ``(T, 2, 3)`` [m].
    heading: ``(T, 2)`` [rad]; soles are level.
    velocity: ``(T, 2, 3)`` [m/s].
    turn_rate: ``(T, 2)`` [rad/s].
    """

    position: NDArray[np.float64]
    heading: NDArray[np.float64]
    velocity: NDArray[np.float64]
    turn_rate: NDArray[np.float64]


class CenterOfMass(NamedTuple):
    """Pendulum at T times: position, velocity and zero-moment point ``(T,)`` [m, m/s, m]."""

    position: Plane
    velocity: Plane
    zmp: Plane


def line(gait: Gait, time: Times) -> Plane:
    """Point that moves on at ``speed`` while its heading, ``turn_rate t``, turns."""
    half = gait.turn_rate * time / 2
    return gait.speed * time * np.sinc(half / np.pi) * np.exp(1j * half)


def footstep(gait: Gait, n: NDArray[np.int64]) -> tuple[Plane, NDArray[np.floating]]:
    """Center and heading [rad] of footsteps: next to the line, where that is at mid-stance."""
    time = (n + 0.5) * gait.step_time
    heading = gait.turn_rate * time
    side = np.where(n % 2 == 0, 1j, -1j) * gait.half_width
    return line(gait, time) + side * np.exp(1j * heading), heading


def feet(gait: Gait, time: Times) -> Feet:
    """Soles at times of a stride.

    The swinging foot goes the share ``3 s^2 - 2 s^3`` of its way and turn, s being the share of
    its time, and rises to ``16 lift s^2 (1 - s)^2``: it leaves and meets the floor at rest.
    """
    n = np.floor(time / gait.step_time).astype(np.int64)
    swing_time = gait.step_time - gait.double_support
    s = (time - n * gait.step_time - gait.double_support / 2) / swing_time
    s = np.clip(s, 0.0, 1.0)
    share, rate = s**2 * (3 - 2 * s), 6 * s * (1 - s) / swing_time
    stance, stance_heading = footstep(gait, n)
    begin, begin_heading = footstep(gait, n - 1)
    end, end_heading = footstep(gait, n + 1)
    swing, speed = begin + share * (end - begin), rate * (end - begin)
    turn = end_heading - begin_heading
    rows, standing, swinging = np.arange(len(time)), n % 2, (n + 1) % 2
    out = Feet(*(np.zeros((len(time), 2, *shape)) for shape in ((3,), (), (3,), ())))
    out.position[rows, standing, :2] = _columns(stance)
    out.position[rows, swinging, :2] = _columns(swing)
    out.position[rows, swinging, 2] = 16 * gait.lift * s**2 * (1 - s) ** 2
    out.velocity[rows, swinging, :2] = _columns(speed)
    out.velocity[rows, swinging, 2] = 32 * gait.lift * s * (1 - s) * (1 - 2 * s) / swing_time
    out.heading[rows, standing] = stance_heading
    out.heading[rows, swinging] = begin_heading + share * turn
    out.turn_rate[rows, swinging] = rate * turn
    return out


def center_of_mass(gait: Gait, time: Times) -> CenterOfMass:
    """The only motion of the pendulum that repeats from stride to stride, at times of a stride.

    ``c'' = w^2 (c - p)`` with ``w = sqrt(g / com_height)``. The zero-moment point p rests in the
    center of the standing sole and moves evenly to the next in double support. With
    ``u = c +- c' / w`` (plus: the capture point) this is ``u' = +-w (u - p)``; while p moves at
    a constant rate r::

        u(t) = p(t) +- r / w + exp(+-w (t - t0)) (u(t0) - p(t0) -+ r / w)

    Going through a stride makes ``u(end) = a u(begin) + b`` of it; that it shall repeat,
    ``u(end) = way + turn u(begin)``, gives ``u(begin) = (b - way) / (turn - a)``.

    Source: Kajita et al., "The 3D linear inverted pendulum mode", IROS 2001; capture point:
    Koolen et al., "Capturability-based analysis and control of legged locomotion, Part 1",
    IJRR 2012. Periodic double support with a moving zero-moment point is put in by us.
    """
    w = (GRAVITY / gait.com_height) ** 0.5
    begin, end = gait.stride
    half = gait.double_support / 2
    knots = np.array([begin, gait.step_time - half, gait.step_time + half, end - 2 * half, end])
    corners, _ = footstep(gait, np.array([0, 0, 1, 1, 2]))
    rates = np.diff(corners) / np.diff(knots)
    part = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, 3)
    since = time - knots[part]
    zmp = corners[part] + rates[part] * since
    turn = np.exp(1j * gait.turn_rate * (end - begin))
    way = line(gait, np.array([end - begin]))[0]
    modes = []
    for sign in (1, -1):
        lead = sign * rates / w
        first = _through(0.0, sign * w, knots, corners, lead)[-1]
        first = (first - way) / (turn - np.exp(sign * w * (end - begin)))
        u = _through(first, sign * w, knots, corners, lead)
        departure = u[part] - corners[part] - lead[part]
        modes.append(zmp + lead[part] + np.exp(sign * w * since) * departure)
    ahead, behind = modes
    return CenterOfMass((ahead + behind) / 2, w * (ahead - behind) / 2, zmp)


def _through(u: complex, w: float, knots: Times, corners: Plane, lead: Plane) -> Plane:
    """A mode ``u' = w (u - p)`` at the knots, from its value at the first."""
    out = [u]
    for k, growth in enumerate(np.exp(w * np.diff(knots))):
        out.append(corners[k + 1] + lead[k] + growth * (out[k] - corners[k] - lead[k]))
    return np.array(out)


def _columns(points: Plane) -> NDArray[np.float64]:
    return np.stack([points.real, points.imag], -1)
