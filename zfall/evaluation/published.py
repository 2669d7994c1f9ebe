"""Pushes that others published, in units in which robots of all sizes compare."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from zfall.envs.transforms.pushes.profiles import find_profile
from zfall.evaluation.pendulum import duration_factor, no_step_bound
from zfall.robots import GRAVITY, Robot


@dataclass(frozen=True, kw_only=True)
class Body:
    """Mass and height of a robot, by which pushes are scaled.

    Args:
        mass: [kg].
        com_height: of the center of mass of the standing robot [m].
    """

    mass: float
    com_height: float

    @property
    def impulse_unit(self) -> float:
        """Impulse of dimensionless size 1, ``m sqrt(g h0)`` [N s]."""
        return self.mass * (GRAVITY * self.com_height) ** 0.5

    @property
    def time_unit(self) -> float:
        """``sqrt(h0 / g)`` [s]."""
        return (self.com_height / GRAVITY) ** 0.5


@dataclass(frozen=True, kw_only=True)
class PublishedPush:
    """A push of a paper.

    Args:
        system: whose.
        what: what was done with it, with its section.
        body: that was pushed.
        force: its peak [N].
        duration: [s].
        profile: of ``zfall.envs.transforms.pushes.profiles``.
    """

    system: str
    what: str
    body: Body
    force: float
    duration: float
    profile: str = "rectangular"


def published_table(robot: Robot, pushes: Sequence[PublishedPush]) -> pd.DataFrame:
    """Published pushes, and what they are on another robot.

    ``impulse``: dimensionless, ``I = J / (m sqrt(g h0))``. ``sudden``: that of a sudden push that
    tips as far, ``I / f`` with ``f = w T / (1 - e^(-w T))``. ``force_n`` [N], peak, and
    ``duration_s``: on ``robot``, by the same size in units of its own time ``sqrt(h0 / g)``.
    ``of_no_step``: the size over the smallest that asks an inverted pendulum on this robot's feet
    for a step: forward, and to the side; below 1 the ankles suffice.

    Args:
        robot: to which they are carried over.
        pushes: of the papers.
    """
    own = Body(mass=robot.mass, com_height=robot.com_height)
    rows = []
    for push in pushes:
        mean = find_profile(push.profile).mean
        size = mean * push.force * push.duration / push.body.impulse_unit
        duration = push.duration * own.time_unit / push.body.time_unit
        bound = no_step_bound(robot, np.array([0.0, np.pi / 2]), duration)
        rows.append(
            {
                "system": push.system,
                "push": push.what,
                "published_n": push.force,
                "published_s": push.duration,
                "impulse": size,
                "sudden": size / duration_factor(duration, own.com_height),
                "force_n": size * own.impulse_unit / (mean * duration),
                "duration_s": duration,
                "of_no_step_forward": size / bound[0],
                "of_no_step_sideways": size / bound[1],
            }
        )
    return pd.DataFrame(rows)


@dataclass(frozen=True, kw_only=True)
class Jump:
    """A push that is a jump of the base's velocity, and with it of all links'.

    Args:
        system: whose training.
        robot: that was trained.
        speed: the largest [m/s].
        interval: from one to the next, least and most [s].
    """

    system: str
    robot: str
    speed: float
    interval: tuple[float, float]


def robots_table(robots: Sequence[Robot]) -> pd.DataFrame:
    """Robots, what one unit of push is on them, and what a pendulum on their feet withstands.

    ``impulse_unit`` [N s] and ``time_unit`` [s]. ``force_n`` [N]: of a push of I = 0.1 that lasts
    ``duration_s``, 0.1 s of the first robot in units of each one's time. ``forward``,
    ``backward``, ``sideways``: the largest I that needs no step, of such pushes.
    """
    rows = []
    for robot in robots:
        body = Body(mass=robot.mass, com_height=robot.com_height)
        first = Body(mass=robots[0].mass, com_height=robots[0].com_height)
        duration = 0.1 * body.time_unit / first.time_unit
        forward, sideways, backward = no_step_bound(robot, [0.0, np.pi / 2, np.pi], duration)
        rows.append(
            {
                "robot": robot.name,
                "mass": robot.mass,
                "com_height": robot.com_height,
                "impulse_unit": body.impulse_unit,
                "time_unit": body.time_unit,
                "duration_s": duration,
                "force_n": 0.1 * body.impulse_unit / duration,
                "forward": forward,
                "backward": backward,
                "sideways": sideways,
            }
        )
    return pd.DataFrame(rows)


def jumps_table(robots: Sequence[Robot], jumps: Sequence[Jump]) -> pd.DataFrame:
    """Jumps of velocity as dimensionless pushes: ``I = v / sqrt(g h0)``, whatever the mass.

    ``of_no_step_sideways``: the size over the largest sudden push to the side that asks a pendulum
    on the robot's feet for no step.
    """
    by_name = {robot.name: robot for robot in robots}
    rows = []
    for jump in jumps:
        robot = by_name[jump.robot]
        size = jump.speed / (GRAVITY * robot.com_height) ** 0.5
        bound = no_step_bound(robot, [np.pi / 2], 1e-6)[0]
        least, most = jump.interval
        rows.append(
            {
                "system": jump.system,
                "robot": robot.name,
                "speed": jump.speed,
                "every_s": f"{least:g} to {most:g}",
                "impulse": size,
                "of_no_step_sideways": size / bound,
            }
        )
    return pd.DataFrame(rows)
