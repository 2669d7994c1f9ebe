"""How the robot walks.

Velocities are those of the base in its own axes, x forward and y to the left, as a velocimeter on
it would read them.

Source: the rewards of the Zeroth-fall report, with the formulas of the public template that it
began with.
"""

from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.kernels import rbf
from zfall.rotations import heading, rotate_inverse, wrap
from zfall.values import NotNegative, OpenFraction, Positive


def forward_velocity(td: TensorDictBase, next_td: TensorDictBase, *, limit: Positive) -> Tensor:
    """Velocity forward, ``min(v_x, limit)`` [m/s].

    Reads ``base_linear_velocity`` ``(*B, 3)`` [m/s; world] and ``base_orientation``
    ``(*B, 4)``; ``limit`` [m/s]. Returns ``(*B, 1)``.
    """
    return _base_velocity(next_td)[..., :1].clamp_max(limit)


def lateral_velocity(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """Speed sideways, ``|v_y|`` [m/s].

    Reads ``base_linear_velocity`` ``(*B, 3)`` [m/s; world] and ``base_orientation`` ``(*B, 4)``.
    Returns ``(*B, 1)``, at least 0.
    """
    return _base_velocity(next_td)[..., 1:2].abs()


def feet_air_time(td: TensorDictBase, next_td: TensorDictBase, *, threshold: NotNegative) -> Tensor:
    """Time that feet were in the air, paid when they touch down.

    ``sum over feet of (t - threshold)`` [s] in the step of the touchdown, 0 else: a step of the
    foot shorter than ``threshold`` [s] costs.

    Reads ``feet_air_time`` ``(*B, 2)`` [s], which ``FeetAirTime`` keeps, before and after the
    step. Returns ``(*B, 1)``.
    """
    time = td["feet_air_time"]
    landed = (time > 0) & (next_td["feet_air_time"] == 0)
    return ((time - threshold) * landed).sum(-1, keepdim=True)


def velocity_as_commanded(
    td: TensorDictBase, next_td: TensorDictBase, *, cutoff: Positive, epsilon: OpenFraction
) -> Tensor:
    """High when the robot moves as it shall: ``rbf((v_x, v_y), command)``.

    Reads ``base_linear_velocity`` ``(*B, 3)`` [m/s; world] and ``base_orientation`` ``(*B, 4)``
    after the step, and ``command`` ``(*B, 6)`` for it; ``cutoff`` [m/s]. Returns ``(*B, 1)`` in
    (0, 1].

    Source: none; the report pays for speed forward alone.
    """
    velocity = _base_velocity(next_td)[..., :2]
    return rbf(velocity, td["command"][..., :2], cutoff=cutoff, epsilon=epsilon)


def heading_as_commanded(
    td: TensorDictBase, next_td: TensorDictBase, *, cutoff: Positive, epsilon: OpenFraction
) -> Tensor:
    """High when the robot heads where it shall: ``rbf(heading - commanded heading, 0)``.

    Reads ``base_orientation`` ``(*B, 4)`` and ``commanded_heading`` ``(*B, 1)`` [rad];
    ``cutoff`` [rad]. Returns ``(*B, 1)`` in (0, 1].

    Source: none; without it a robot that walks straight by its own axes walks in circles.
    """
    error = wrap(heading(next_td["base_orientation"]) - next_td["commanded_heading"])
    return rbf(error, 0.0, cutoff=cutoff, epsilon=epsilon)


def _base_velocity(td: TensorDictBase) -> Tensor:
    return rotate_inverse(td["base_orientation"], td["base_linear_velocity"])
