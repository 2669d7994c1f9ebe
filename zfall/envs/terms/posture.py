"""How the body stands and whether it lives."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.robots import Robot
from zfall.envs.rotations import tilt


def survival(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """1 for every step that does not end the episode; returns ``(*B, 1)``.

    Reads ``terminated``, so ``Terminations`` must come before the reward.
    """
    return (~next_td["terminated"]).float()


def termination(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """1 for the step that ends the episode for good; returns ``(*B, 1)``. See ``survival``."""
    return next_td["terminated"].float()


def upright(td: TensorDictBase, next_td: TensorDictBase, *, sigma: float) -> Tensor:
    """High when the trunk is vertical: ``exp(-(1 - cos(tilt)) / sigma)``.

    Reads ``base_orientation`` ``(*B, 4)``; ``sigma`` has no unit. Returns ``(*B, 1)`` in (0, 1].
    """
    angle = tilt(next_td["base_orientation"])
    return torch.exp((angle.cos() - 1.0) / sigma).unsqueeze(-1)


def reference_posture(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, sigma: float
) -> Tensor:
    """High in the standing reference pose: ``exp(-|q - q0|^2 / sigma^2)``.

    Reads ``joint_position`` ``(*B, J)`` [rad]; ``sigma`` [rad]. Returns ``(*B, 1)`` in (0, 1].
    """
    position = next_td["joint_position"]
    error = position - position.new_tensor(robot.stand_position)
    return torch.exp(-error.square().sum(-1, keepdim=True) / sigma**2)
