"""Center of mass, capture point and base motion."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.robots import GRAVITY


def base_speed(td: TensorDictBase, next_td: TensorDictBase, *, sigma: float) -> Tensor:
    """High when the base does not travel: ``exp(-|v_xy|^2 / sigma^2)``.

    Reads ``base_linear_velocity`` ``(*B, 3)`` [m/s; world]; ``sigma`` [m/s].
    Returns ``(*B, 1)`` in (0, 1].
    """
    velocity = next_td["base_linear_velocity"][..., :2]
    return torch.exp(-velocity.square().sum(-1, keepdim=True) / sigma**2)


def capture_point(td: TensorDictBase, next_td: TensorDictBase, *, sigma: float) -> Tensor:
    """High when the robot could come to rest over its feet without another step.

    ``exp(-|xi|^2 / sigma^2)``, with ``xi = x + v sqrt(z / g)`` the instantaneous capture point of
    the center of mass, measured from the mean position of the feet.

    Reads ``com_position`` [m] and ``com_velocity`` [m/s] ``(*B, 3)`` and ``feet_position`` [m]
    ``(*B, 2, 3)``, all in world axes; ``sigma`` [m]. Returns ``(*B, 1)`` in (0, 1].

    Source: Koolen et al., "Capturability-based analysis and control of legged locomotion,
    Part 1", IJRR 2012, doi:10.1177/0278364912452673.
    """
    lean = next_td["com_position"] - next_td["feet_position"].mean(-2)
    fall_time = (lean[..., 2:].clamp_min(0.0) / GRAVITY).sqrt()  # [s]
    xi = lean[..., :2] + next_td["com_velocity"][..., :2] * fall_time
    return torch.exp(-xi.square().sum(-1, keepdim=True) / sigma**2)
