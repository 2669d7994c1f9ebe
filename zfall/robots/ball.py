"""A ball to throw at a robot."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Ball:
    """A free ball beside the robot, for ``ThrownBall``.

    Args:
        mass: [kg].
        radius: [m].
    """

    mass: float
    radius: float
