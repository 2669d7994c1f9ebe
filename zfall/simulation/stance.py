"""Geometry of the standing reference pose."""

from dataclasses import dataclass
from functools import cache

import mujoco
import torch
from torch import Tensor

from zfall.robots import Robot, bare_model
from zfall.rotations import mean_orientation, rotate_inverse, turn_between, turn_to_heading


@dataclass(frozen=True)
class Stance:
    """How the robot stands in the keyframe ``stand`` of its MJCF.

    Attributes:
        com: from the base to the center of mass, forward and to the left ``(2,)`` [m].
        feet_offset: from the left to the right foot, in the axes of the mean foot ``(3,)`` [m].
        feet_turn: of the right foot against the left one ``(4,)``, a quaternion.
    """

    com: Tensor
    feet_offset: Tensor
    feet_turn: Tensor


def stance(robot: Robot) -> Stance:
    """The standing pose of a robot; compiled once."""
    return _read(robot)


@cache
def _read(robot: Robot) -> Stance:
    model = bare_model(robot)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)

    def read(name: str) -> Tensor:
        return torch.tensor(data.sensor(name).data).float()

    base = torch.tensor(data.qpos[:7]).float()
    com = turn_to_heading(base[3:], (read("com_position") - base[:3])[:2])
    left, right = (read(f"feet_orientation/{foot}") for foot in robot.feet)
    apart = read(f"feet_position/{robot.feet[1]}") - read(f"feet_position/{robot.feet[0]}")
    offset = rotate_inverse(mean_orientation(left, right), apart)
    return Stance(com, offset, turn_between(left, right))
