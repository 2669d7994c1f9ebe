"""What motion costs.

Source, where a term names no other: the rewards of the Zeroth-fall report and of its design notes,
with the formulas of the public template that it began with.
"""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.kernels import rbf
from zfall.values import OpenFraction, Positive


def action_rate(td: TensorDictBase, next_td: TensorDictBase, *, per_joint: bool = False) -> Tensor:
    """Squared change of the action from one step to the next, summed over joints.

    Reads ``action`` and ``last_action`` ``(*B, J)`` before the step, without unit. With
    ``per_joint`` the mean over joints. Returns ``(*B, 1)``, at least 0.
    """
    square = (td["action"] - td["last_action"]).square()
    return square.mean(-1, keepdim=True) if per_joint else square.sum(-1, keepdim=True)


def commanded_velocity(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    limit: Positive,
    cutoff: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High when the action asks for little motion: ``rbf(limit clamp(a, -1, 1), 0)``.

    Reads ``action`` ``(*B, J)`` before the step, as ``JointVelocityTarget`` does; ``limit``, the
    velocity of an action of 1, and ``cutoff``, of the norm over joints, in [rad/s]. Returns
    ``(*B, 1)`` in (0, 1].

    Source: Ferigo et al., RA-L 2021, table II (joint velocities).
    """
    velocity = limit * td["action"].clamp(-1.0, 1.0)
    return rbf(velocity, 0.0, cutoff=cutoff, epsilon=epsilon)


def joint_effort(
    td: TensorDictBase, next_td: TensorDictBase, *, cutoff: Positive, epsilon: OpenFraction
) -> Tensor:
    """High when the servos do little: ``rbf(mean |torque|, 0)``.

    Reads ``joint_effort`` ``(*B, 1)`` [N m], which ``JointEffort`` keeps; ``cutoff`` [N m].
    Returns ``(*B, 1)`` in (0, 1].

    Source: Ferigo et al., RA-L 2021, table II (joint torques).
    """
    return rbf(next_td["joint_effort"], 0.0, cutoff=cutoff, epsilon=epsilon)


def joint_torque(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """Sum over joints of the squared mean torque of the step [N2 m2].

    Reads ``joint_torque`` ``(*B, J)`` [N m]. Returns ``(*B, 1)``, at least 0.
    """
    return next_td["joint_torque"].square().sum(-1, keepdim=True)


def servo_power(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """Power that the servos put into the joints or take out of them, summed over joints [W].

    ``sum_j |torque_j velocity_j|``, of the mean torque of the step and the velocity at its end.
    Reads ``joint_torque`` [N m] and ``joint_velocity`` [rad/s] ``(*B, J)``. Returns ``(*B, 1)``,
    at least 0.
    """
    power = next_td["joint_torque"] * next_td["joint_velocity"]
    return power.abs().sum(-1, keepdim=True)


def joint_limits(td: TensorDictBase, next_td: TensorDictBase, *, joint_range: Tensor) -> Tensor:
    """How far the joints are beyond their ranges, summed over joints [rad].

    Reads ``joint_position`` ``(*B, J)`` [rad]; ``joint_range`` ``(J, 2)`` [rad] is given by the
    env. Returns ``(*B, 1)``, at least 0.
    """
    low, high = joint_range.unbind(-1)
    position = next_td["joint_position"]
    beyond = position - torch.clamp(position, low, high)
    return beyond.abs().sum(-1, keepdim=True)
