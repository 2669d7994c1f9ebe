"""What the feet do and carry."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.kernels import rbf
from zfall.robots import GRAVITY, Robot
from zfall.rotations import up_axis
from zfall.values import OpenFraction, Positive


def feet_in_contact(td: TensorDictBase, next_td: TensorDictBase, *, both: bool = False) -> Tensor:
    """1 where any foot touches the floor, or both of them do; returns ``(*B, 1)``.

    Reads ``feet_contact`` ``(*B, 2)``. Source: Ferigo et al., RA-L 2021, section IV-C, whose text
    asks for any foot and whose table II for both.
    """
    contact = next_td["feet_contact"]
    return (contact.all(-1) if both else contact.any(-1)).float().unsqueeze(-1)


def balanced_load(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    cutoff: Positive,
    epsilon: OpenFraction,
    per_foot: bool = False,
) -> Tensor:
    """High where each foot carries half of the robot: mean over feet of ``rbf(F_z, m g / 2)``.

    With ``per_foot`` the sum over feet, so that the weight is that of each. Reads ``feet_force``
    ``(*B, 2, 3)`` [N; world]; ``cutoff`` [N]. Returns ``(*B, 1)`` in (0, 1], or in (0, 2].

    Source: Ferigo et al., RA-L 2021, table II (feet contact forces).
    """
    load = next_td["feet_force"][..., 2:]  # (*B, 2, 1)
    half = 0.5 * robot.mass * GRAVITY
    value = rbf(load, half, cutoff=cutoff, epsilon=epsilon)
    return value.sum(-2) if per_foot else value.mean(-2)


def centered_pressure(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    cutoff: Positive,
    epsilon: OpenFraction,
    per_foot: bool = False,
) -> Tensor:
    """High where each foot is pressed on at its center: mean over feet of ``rbf(cop, 0)``.

    A foot that carries nothing counts 0. With ``per_foot`` the sum over feet. Reads ``feet_cop``
    ``(*B, 2, 2)`` [m; sole] and ``feet_force`` ``(*B, 2, 3)`` [N]; ``cutoff`` [m]. Returns
    ``(*B, 1)`` in [0, 1], or in [0, 2].

    Source: Ferigo et al., RA-L 2021, table II (feet CoPs).
    """
    value = rbf(next_td["feet_cop"], 0.0, cutoff=cutoff, epsilon=epsilon)
    value = torch.where((next_td["feet_force"] != 0.0).any(-1, keepdim=True), value, 0.0)
    return value.sum(-2) if per_foot else value.mean(-2)


def flat_feet(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    cutoff: Positive,
    epsilon: OpenFraction,
    per_foot: bool = False,
) -> Tensor:
    """High where the soles are level: mean over feet of ``rbf(r_z . e_z, 1)``.

    ``r_z`` is the sole's upward axis, ``e_z`` the world's. With ``per_foot`` the sum over feet.
    Reads ``feet_orientation`` ``(*B, 2, 4)``; ``cutoff`` has no unit. Returns ``(*B, 1)`` in
    (0, 1], or in (0, 2].

    Source: Ferigo et al., RA-L 2021, table II (feet orientation).
    """
    level = up_axis(next_td["feet_orientation"])[..., 2:]
    value = rbf(level, 1.0, cutoff=cutoff, epsilon=epsilon)
    return value.sum(-2) if per_foot else value.mean(-2)


def carried_weight(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    cutoff: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High when the feet together carry the robot: ``rbf(sum F_z, m g)``.

    Reads ``feet_force`` ``(*B, 2, 3)`` [N; world]; ``cutoff`` [N]. Returns ``(*B, 1)`` in (0, 1].

    Source: Duburcq et al., IROS 2022, section IV-D.3 (balanced contact forces). The contact
    states by which it multiplies each force change nothing: without contact there is no force,
    and in its standing reference both feet are on the floor.
    """
    load = next_td["feet_force"][..., 2].sum(-1, keepdim=True)
    return rbf(load, robot.mass * GRAVITY, cutoff=cutoff, epsilon=epsilon)


def tangential_force(
    td: TensorDictBase, next_td: TensorDictBase, *, cutoff: Positive, epsilon: OpenFraction
) -> Tensor:
    """High when no foot pushes sideways: ``rbf(F_xy, 0)`` over both feet.

    Reads ``feet_force`` ``(*B, 2, 3)`` [N; world]; ``cutoff`` [N]. Returns ``(*B, 1)`` in (0, 1].

    Source: Duburcq et al., IROS 2022, section IV-D.3 (ground friction).
    """
    force = next_td["feet_force"][..., :2].flatten(-2)
    return rbf(force, 0.0, cutoff=cutoff, epsilon=epsilon)
