"""Numbers of the default robot at the size of another one: the same, without dimensions.

Lengths go with the height h of the center of mass, times with its square root, as gravity is the
same for all; masses and what follows with the mass.
"""

import json
from collections.abc import Mapping
from functools import cache
from typing import Any

from zfall.errors import named
from zfall.robots.robot import Robot
from zfall.robots.zeroth01 import ZEROTH01

PLACE = "env.base_env.robot"
_DIGITS = 4  # of what yaml then has


def factor(robot: Robot, unit: str) -> float:
    """By how much larger a quantity is on a robot than on the default one.

    Args:
        robot: the robot.
        unit: ``length``, ``time``, ``speed``, ``rate`` (1 over time) or ``force``.

    Raises:
        ValueError: on another unit.
    """
    longer, heavier = robot.com_height / ZEROTH01.com_height, robot.mass / ZEROTH01.mass
    factors = {
        "length": longer,
        "time": longer**0.5,
        "speed": longer**0.5,
        "rate": longer**-0.5,
        "force": heavier,
    }
    if unit not in factors:
        raise ValueError(f"unit must be one of {', '.join(factors)}, got {unit!r}.")
    return factors[unit]


def sized(value: float, unit: str, robot: Mapping[str, Any]) -> float:
    """A number of the default robot's yaml for the robot of a config, to four digits."""
    return float(f"{value * factor(_built(json.dumps(robot)), unit):.{_DIGITS}g}")


@cache
def _built(config: str) -> Robot:
    from hydra.utils import instantiate

    with named(PLACE):
        robot = instantiate(json.loads(config), _convert_="all")
        if not isinstance(robot, Robot):
            raise ValueError("_target_ must be zfall.robots.Robot, or one that gives such.")
    return robot
