"""How far the robot is from its reference, standing at rest.

Each term takes one feature of the reference by itself, so that one which is far off does not hide
the others: rbf kernels vanish there.

Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning:
application to standing push recovery on the exoskeleton Atalante", IROS 2022, section IV-D. Its
``exp(-kappa c^2)`` is ``rbf`` with ``kappa = -ln(epsilon) / cutoff^2``.
"""

from functools import cache

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.kernels import rbf
from zfall.robots import Robot
from zfall.rotations import (
    mean_orientation,
    rotate_inverse,
    rotation_angle,
    turn_between,
)
from zfall.simulation.stance import stance
from zfall.values import OpenFraction, Positive


def odometry_velocity(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    radius: Positive,
    cutoff: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High when the robot stays where it is: ``rbf((v_x, v_y, radius w_z), 0)``.

    The mean velocity of the odometry pose since the step before: base position in the plane and
    heading. Reads ``odometry_velocity`` ``(*B, 3)`` [m/s, m/s, rad/s], see ``MeanVelocity``;
    ``radius`` [m] says what a turn counts, ``cutoff`` [m/s]. Returns ``(*B, 1)`` in (0, 1].

    Source: IV-D.1 (odometry), which adds m/s and rad/s as they are, a radius of 1 m on a robot
    4.3 times as large.
    """
    velocity = next_td["odometry_velocity"]
    scale = velocity.new_tensor([1.0, 1.0, radius])
    return rbf(velocity * scale, 0.0, cutoff=cutoff, epsilon=epsilon)


def reference_configuration(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    cutoff: Positive,
    epsilon: OpenFraction,
    joints: str = "legs",
) -> Tensor:
    """High in the standing reference pose: ``rbf(q, q0)``, of the joints of the legs or of all.

    Reads ``joint_position`` ``(*B, J)`` [rad]; ``cutoff`` [rad]; ``joints`` as in
    ``Robot.index_of``. Returns ``(*B, 1)`` in (0, 1].

    Source: IV-D.1 (reference configuration); that robot's motors are those of its legs.
    """
    error = configuration_error(next_td["joint_position"], robot, joints)
    return rbf(error, 0.0, cutoff=cutoff, epsilon=epsilon)


def configuration_error(position: Tensor, robot: Robot, joints: str) -> Tensor:
    """Norm ``(*B, 1)`` [rad] of ``q - q0`` over a group of joints.

    Args:
        position: of all joints ``(*B, J)`` [rad].
        robot: whose standing reference pose is q0.
        joints: which, see ``Robot.index_of``.
    """
    index, reference = _reference(robot.joints, robot.stand_position, robot.index_of(joints))
    error = position.index_select(-1, index) - reference
    return error.norm(dim=-1, keepdim=True)


def feet_relative_position(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    cutoff: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High when the feet are as far apart as in the reference: ``rbf(p, p0)``.

    ``p = R_m^T (p_right - p_left)`` in the axes of the mean foot, whose quaternion is
    ``q_m = (q_right + q_left) / 2``, normalised: neither the base nor where the robot stands and
    looks to has a share in it.

    Reads ``feet_position`` ``(*B, 2, 3)`` [m] and ``feet_orientation`` ``(*B, 2, 4)``;
    ``cutoff`` [m]. Returns ``(*B, 1)`` in (0, 1].

    Source: IV-D.1 (foot positions and orientations).
    """
    left, right = next_td["feet_orientation"].unbind(-2)
    position = next_td["feet_position"]
    apart = position[..., 1, :] - position[..., 0, :]
    offset = rotate_inverse(mean_orientation(left, right), apart)
    return rbf(offset, stance(robot).feet_offset, cutoff=cutoff, epsilon=epsilon)


def feet_relative_orientation(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    cutoff: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High when the feet are turned against each other as in the reference.

    ``rbf(log(R R0^T), 0)``, R being the turn from the left to the right foot in the axes of the
    mean foot, ``R = R_m^T (R_right R_left^T) R_m``. With R_m halfway between the two that is
    ``R_left^T R_right``, which is how it is computed.

    Reads ``feet_orientation`` ``(*B, 2, 4)``; ``cutoff`` [rad]. Returns ``(*B, 1)`` in (0, 1].

    Source: IV-D.1 (foot positions and orientations), which prints R without its last factor; it
    would then change when the robot as a whole turns, against the purpose given there.
    """
    left, right = next_td["feet_orientation"].unbind(-2)
    turn = turn_between(left, right)
    # |log(R R0^T)| = |log(R0^T R)|: turning both by R0 does not change an angle.
    error = rotation_angle(turn_between(stance(robot).feet_turn.expand_as(turn), turn))
    return rbf(error, 0.0, cutoff=cutoff, epsilon=epsilon)


def base_turning(
    td: TensorDictBase, next_td: TensorDictBase, *, cutoff: Positive, epsilon: OpenFraction
) -> Tensor:
    """High when the base does not turn: ``rbf(w, 0)``, w its mean since the step before.

    Reads ``base_mean_angular_velocity`` ``(*B, 3)`` [rad/s], see ``MeanVelocity``; ``cutoff``
    [rad/s]. Returns ``(*B, 1)`` in (0, 1].

    Source: IV-D.3 (pelvis momentum).
    """
    return rbf(next_td["base_mean_angular_velocity"], 0.0, cutoff=cutoff, epsilon=epsilon)


@cache
def _reference(
    joints: tuple[str, ...], stand: tuple[float, ...], index: tuple[int, ...]
) -> tuple[Tensor, Tensor]:
    """Indices and reference angles of a group of joints."""
    places = torch.tensor(index)
    return places, torch.tensor(stand)[places]
