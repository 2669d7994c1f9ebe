"""Pushes of the three published systems, in units in which robots of all sizes compare."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from zfall.envs.transforms.pushes.profiles import find_profile
from zfall.evaluation.pendulum import duration_factor, no_step_bound
from zfall.robots import GRAVITY, Robot


@dataclass(frozen=True, kw_only=True)
class Body:
    """What of a robot pushes are compared by.

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


ICUB = Body(mass=33.0, com_height=0.53)  # the mass is published, the height our estimate
ATALANTE = Body(mass=135.0, com_height=0.95)
ZEROTH = Body(mass=3.349, com_height=0.220)  # the same robot

PUSHES = (
    *(
        PublishedPush(system="iCub", what=what, body=ICUB, force=force, duration=0.2)
        for force, what in (
            (200.0, "training (IV-D)"),
            (300.0, "recovered in all directions (VI-C)"),
            (400.0, "recovered in some directions (VI-C)"),
        )
    ),
    PublishedPush(
        system="Atalante",
        what="training (IV-A.4)",
        body=ATALANTE,
        force=800.0,
        duration=0.4,
        profile="gaussian",
    ),
    PublishedPush(
        system="Atalante",
        what="recovered fore and aft, 190 N s (V-C)",
        body=ATALANTE,
        force=475.0,
        duration=0.4,
    ),
    *(
        PublishedPush(system="Zeroth-01", what=what, body=ZEROTH, force=force, duration=0.1)
        for force, what in (
            (20.0, "stage easy (3)"),
            (40.0, "stage medium (3)"),
            (60.0, "stage hard (3)"),
            (100.0, "stage kneel trigger (3)"),
        )
    ),
)


def published_table(robot: Robot, pushes: Sequence[PublishedPush] = PUSHES) -> pd.DataFrame:
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
