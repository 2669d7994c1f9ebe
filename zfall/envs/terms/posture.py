"""How the body stands and whether it lives.

Source, where a term names no other: the rewards of the Zeroth-fall report and of its design notes;
kernels are ours.
"""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.kernels import rbf
from zfall.robots import Robot
from zfall.rotations import cos_tilt
from zfall.values import OpenFraction, Positive


def survival(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """1 for every step that does not end the episode; returns ``(*B, 1)``.

    Reads ``terminated``, so ``Terminations`` must come before the reward.
    """
    return (~next_td["terminated"]).float()


def termination(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """1 for the step that ends the episode for good; returns ``(*B, 1)``. See ``survival``."""
    return next_td["terminated"].float()


def upright(td: TensorDictBase, next_td: TensorDictBase, *, sigma: Positive) -> Tensor:
    """High when the trunk is vertical: ``exp(-(1 - cos(tilt)) / sigma)``.

    Reads ``base_orientation`` ``(*B, 4)``; ``sigma`` has no unit. Returns ``(*B, 1)`` in (0, 1].
    """
    return torch.exp((cos_tilt(next_td["base_orientation"]) - 1.0) / sigma)


def reference_posture(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, sigma: Positive
) -> Tensor:
    """High in the standing reference pose: ``exp(-|q - q0|^2 / sigma^2)``.

    Reads ``joint_position`` ``(*B, J)`` [rad]; ``sigma`` [rad]. Returns ``(*B, 1)`` in (0, 1].
    """
    position = next_td["joint_position"]
    error = position - position.new_tensor(robot.stand_position)
    return torch.exp(-error.square().sum(-1, keepdim=True) / sigma**2)


def double_support_posture(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    cutoff: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High in the standing reference pose, with both feet on the floor: ``rbf(q, q0)``.

    Reads ``joint_position`` ``(*B, J)`` [rad] and ``feet_contact`` ``(*B, 2)``; ``cutoff``, of the
    norm over joints [rad]. 0 outside double support. Returns ``(*B, 1)`` in [0, 1].

    Source: Ferigo et al., RA-L 2021, table II (postural).
    """
    position = next_td["joint_position"]
    target = position.new_tensor(robot.stand_position)
    value = rbf(position, target, cutoff=cutoff, epsilon=epsilon)
    return torch.where(next_td["feet_contact"].all(-1, keepdim=True), value, 0.0)


def standing_height(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, sigma: Positive
) -> Tensor:
    """High when the center of mass is as high as when standing: ``exp(-(z - h0)^2 / sigma^2)``.

    Reads ``com_position`` ``(*B, 3)`` [m]; ``sigma`` [m]. Returns ``(*B, 1)`` in (0, 1].
    """
    error = next_td["com_position"][..., 2:] - robot.com_height
    return torch.exp(-error.square() / sigma**2)


def arm_pose(td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot) -> Tensor:
    """Distance of the arms from the standing reference pose, ``sum_j |q_j - q0_j|`` [rad].

    The joints of the arms are those that are not of the legs. Reads ``joint_position`` ``(*B, J)``
    [rad]. Returns ``(*B, 1)``, at least 0.
    """
    arms = [j for j, name in enumerate(robot.joints) if name not in robot.legs]
    position = next_td["joint_position"][..., arms]
    target = position.new_tensor([robot.stand_position[j] for j in arms])
    return (position - target).abs().sum(-1, keepdim=True)
