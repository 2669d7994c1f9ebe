"""Bounds whose violation ends an episode, so that a policy keeps to them.

Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning:
application to standing push recovery on the exoskeleton Atalante", IROS 2022, section IV-C.
"""

from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.footprints import footprint_distance, footprints
from zfall.robots import Robot
from zfall.rotations import roll_and_pitch, up_axis
from zfall.values import Bounds, NotNegative, Positive


def base_low(td: TensorDictBase, next_td: TensorDictBase, *, height: NotNegative) -> Tensor:
    """Whether the base is not higher than ``height`` [m] above the floor.

    Reads ``base_position`` ``(*B, 3)`` [m]. Returns ``(*B, 1)`` bool. Source: IV-C.1.
    """
    return next_td["base_position"][..., 2:] <= height


def base_tilted(
    td: TensorDictBase, next_td: TensorDictBase, *, roll: Bounds, pitch: Bounds
) -> Tensor:
    """Whether roll or pitch of the base leave their ranges [rad], positive right and forward.

    Reads ``base_orientation`` ``(*B, 4)``. Returns ``(*B, 1)`` bool. Source: IV-C.1.
    """
    angle = roll_and_pitch(up_axis(next_td["base_orientation"]))
    low, high = angle.new_tensor([roll, pitch]).unbind(-1)
    return ((angle <= low) | (angle >= high)).any(-1, keepdim=True)


def feet_close(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, distance: NotNegative
) -> Tensor:
    """Whether the footprints are within ``distance`` [m] of each other.

    Between the hulls of the soles' vertical projections: feet that cross in the air count, too.
    Reads what ``footprints`` reads. Returns ``(*B, 1)`` bool. Source: IV-C.2.
    """
    return (footprint_distance(*footprints(next_td, robot)) <= distance).unsqueeze(-1)


def stop_hit(td: TensorDictBase, next_td: TensorDictBase, *, speed: NotNegative) -> Tensor:
    """Whether a joint was at a stop with ``speed`` [rad/s] or more during the step.

    Reads ``joint_stop_speed`` ``(*B, 1)`` [rad/s], see ``JointStopSpeed``. Returns ``(*B, 1)``
    bool. Source: IV-C.3.
    """
    return next_td["joint_stop_speed"] >= speed


def drifted(
    td: TensorDictBase, next_td: TensorDictBase, *, x: Positive, y: Positive, heading: Positive
) -> Tensor:
    """Whether the robot has gone or turned too far: ``x``, ``y`` [m], ``heading`` [rad].

    Reads ``odometry_displacement`` ``(*B, 3)``, see ``OdometryDisplacement``. Returns ``(*B, 1)``
    bool. Source: IV-C.4.
    """
    displacement = next_td["odometry_displacement"].abs()
    bound = displacement.new_tensor([x, y, heading])
    return (displacement >= bound).any(-1, keepdim=True)


def reference_left(td: TensorDictBase, next_td: TensorDictBase, *, error: Positive) -> Tensor:
    """Whether the robot has not been within ``error`` [rad] of its reference for a while.

    Reads ``joint_error_min`` ``(*B, 1)`` [rad], see ``JointErrorMin``. Returns ``(*B, 1)`` bool.
    Source: IV-C.5.
    """
    return next_td["joint_error_min"] >= error


def overpowered(td: TensorDictBase, next_td: TensorDictBase, *, power: Positive) -> Tensor:
    """Whether the joints put out ``power`` [W] or more.

    Reads ``power`` ``(*B, 1)`` [W], see ``JointPower``. Returns ``(*B, 1)`` bool. Source:
    IV-C.6.
    """
    return next_td["power"] >= power
