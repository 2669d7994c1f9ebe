"""When a robot stands again."""

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.falls import body_contact
from zfall.robots import Robot
from zfall.rotations import cos_tilt

# As a battery's recovered: least height of the center of mass, in standing heights, and tilt [rad].
HEIGHT, TILT = 0.8, 0.35


def stands(td: TensorDictBase, robot: Robot) -> Tensor:
    """Whether the robot stands on its feet alone, upright and high, on one or both ``(N,)`` bool.

    Reads ``contact_force_peak`` ``(N, R)`` [N], ``base_orientation`` ``(N, 4)`` and
    ``com_position`` ``(N, 3)`` [m].
    """
    high = td["com_position"][:, 2] > HEIGHT * robot.com_height
    upright = cos_tilt(td["base_orientation"]).squeeze(-1) > math.cos(TILT)
    feet = (td["contact_force_peak"][:, -2:] > 0).any(-1)
    return torch.logical_and(high & upright, feet & ~body_contact(td, td).squeeze(-1))
