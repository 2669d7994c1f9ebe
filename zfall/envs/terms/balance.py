"""Center of mass, capture point and base motion."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.kernels import rbf
from zfall.envs.terms.support import hull_center, support_hull
from zfall.robots import GRAVITY, Robot
from zfall.values import OpenFraction, Positive


def base_speed(td: TensorDictBase, next_td: TensorDictBase, *, sigma: Positive) -> Tensor:
    """High when the base does not travel: ``exp(-|v_xy|^2 / sigma^2)``.

    Reads ``base_linear_velocity`` ``(*B, 3)`` [m/s; world]; ``sigma`` [m/s].
    Returns ``(*B, 1)`` in (0, 1].
    """
    velocity = next_td["base_linear_velocity"][..., :2]
    return torch.exp(-velocity.square().sum(-1, keepdim=True) / sigma**2)


def capture_point(td: TensorDictBase, next_td: TensorDictBase, *, sigma: Positive) -> Tensor:
    """High when the robot could come to rest over its feet without another step.

    ``exp(-|xi|^2 / sigma^2)``, with ``xi = x + v sqrt(z / g)`` the instantaneous capture point of
    the center of mass, measured from the mean position of the feet.

    Reads ``com_position`` [m] and ``com_velocity`` [m/s] ``(*B, 3)`` and ``feet_position`` [m]
    ``(*B, 2, 3)``, all in world axes; ``sigma`` [m]. Returns ``(*B, 1)`` in (0, 1].

    Source: Koolen et al., "Capturability-based analysis and control of legged locomotion,
    Part 1", IJRR 2012, doi:10.1177/0278364912452673.
    """
    return torch.exp(-capture_point_offset(next_td).square().sum(-1, keepdim=True) / sigma**2)


def capture_point_offset(td: TensorDictBase) -> Tensor:
    """The capture point from the mean position of the feet ``(*B, 2)`` [m; world], see above."""
    lean = td["com_position"] - td["feet_position"].mean(-2)
    fall_time = (lean[..., 2:].clamp_min(0.0) / GRAVITY).sqrt()  # [s]
    return lean[..., :2] + td["com_velocity"][..., :2] * fall_time


def vertical_com_speed(
    td: TensorDictBase, next_td: TensorDictBase, *, cutoff: Positive, epsilon: OpenFraction
) -> Tensor:
    """High when the center of mass does not rise or sink: ``rbf(v_z, 0)``.

    Reads ``com_velocity`` ``(*B, 3)`` [m/s]; ``cutoff`` [m/s]. Returns ``(*B, 1)`` in (0, 1].

    Source: Ferigo et al., RA-L 2021, table II (its symbols of the two CoM velocities are
    exchanged in print).
    """
    return rbf(next_td["com_velocity"][..., 2:], 0.0, cutoff=cutoff, epsilon=epsilon)


def com_velocity_to_support(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    cutoff: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High when the center of mass moves to the middle of its support, faster from far away.

    ``rbf(v_xy, omega (c - x))`` with the center c of the support polygon, ``omega = sqrt(g / z)``
    and the center of mass at x and height z. 0 outside double support.

    Reads ``com_position`` [m], ``com_velocity`` [m/s] ``(*B, 3)``, ``feet_contact`` and what
    ``support_hull`` reads; ``cutoff`` [m/s]. Returns ``(*B, 1)`` in [0, 1].

    Source: Ferigo et al., RA-L 2021, section IV-C, by its text: toward the center.
    """
    com = next_td["com_position"]
    omega = (GRAVITY / com[..., 2:].clamp_min(0.01)).sqrt()
    target = omega * (hull_center(support_hull(next_td, robot)) - com[..., :2])
    value = rbf(next_td["com_velocity"][..., :2], target, cutoff=cutoff, epsilon=epsilon)
    return torch.where(next_td["feet_contact"].all(-1, keepdim=True), value, 0.0)


def centroidal_momentum(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    linear: Positive,
    angular: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High when the robot as a whole neither travels nor turns: ``rbf(|p| / P + |L| / A, 0)``.

    Reads ``linear_momentum`` [kg m/s] and ``angular_momentum`` [kg m2/s] ``(*B, 3)``; P and A,
    ``linear`` and ``angular``, are what counts as much. Returns ``(*B, 1)`` in (0, 1].

    Source: Ferigo et al., RA-L 2021, table II (centroidal momentum); there the two norms are
    added as they are, which only works in the units of one robot.
    """
    p = next_td["linear_momentum"].norm(dim=-1, keepdim=True) / linear
    turning = next_td["angular_momentum"].norm(dim=-1, keepdim=True) / angular
    return rbf(p + turning, 0.0, cutoff=1.0, epsilon=epsilon)
