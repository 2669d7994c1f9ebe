"""Where the robot could come to rest, and where the floor pushes back.

Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning:
application to standing push recovery on the exoskeleton Atalante", IROS 2022, section IV-D.2.
"""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.kernels import rbf
from zfall.robots import GRAVITY, Robot
from zfall.rotations import turn_to_heading
from zfall.simulation.stance import stance
from zfall.values import OpenFraction, Positive

_LEAST_LOAD = 0.1  # share of the weight: in flight the zero-moment point does not exist


def instantaneous_capture_point(td: TensorDictBase) -> Tensor:
    """``x + v sqrt(z / g)`` of the center of mass, z above the floor ``(*B, 2)`` [m; world].

    Reads ``com_position`` [m] and ``com_velocity`` [m/s] ``(*B, 3)``.

    Source: Koolen et al., "Capturability-based analysis and control of legged locomotion,
    Part 1", IJRR 2012, doi:10.1177/0278364912452673.
    """
    com = td["com_position"]
    fall_time = (com[..., 2:].clamp_min(0.0) / GRAVITY).sqrt()  # [s]
    return com[..., :2] + td["com_velocity"][..., :2] * fall_time


def zero_moment_point(td: TensorDictBase, mass: float) -> Tensor:
    """Where the floor's force would have to act ``(*B, 2)`` [m; world] for the robot's motion.

    With the center of mass c, momentum p and angular momentum L about c::

        F = dp_z/dt + m g
        x = c_x - (c_z dp_x/dt + dL_y/dt) / F
        y = c_y - (c_z dp_y/dt - dL_x/dt) / F

    The balance of moments about a point of a level floor, at which nothing else acts: under a
    push the two differ from the center of pressure by the push's own moment. F is taken to be at
    least a tenth of the weight; a robot in free fall has its zero-moment point below its center
    of mass.

    Reads ``com_position`` ``(*B, 3)`` [m], ``momentum_rate`` [N] and ``angular_momentum_rate``
    [N m] ``(*B, 3)``, means over a control step, see ``MomentumRate``.

    Args:
        td: what to read from.
        mass: m [kg].

    Source: Kajita et al., "Biped walking pattern generation by using preview control of
    zero-moment point", ICRA 2003, with the angular momentum that is left out there.
    """
    com, force, moment = td["com_position"], td["momentum_rate"], td["angular_momentum_rate"]
    weight = mass * GRAVITY
    load = (force[..., 2:] + weight).clamp_min(_LEAST_LOAD * weight)
    turning = torch.stack([moment[..., 1], -moment[..., 0]], -1)
    return com[..., :2] - (com[..., 2:] * force[..., :2] + turning) / load


def capture_point_in_base(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    cutoff: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High when the capture point lies below the base as it does in the reference.

    ``rbf(xi - b, xi0 - b0)`` with the capture point xi and the base's position b in the plane,
    seen along the base's heading. Going to where the robot is falling brings it closer.

    Reads ``base_position`` ``(*B, 3)`` [m], ``base_orientation`` ``(*B, 4)`` and what
    ``instantaneous_capture_point`` reads; ``cutoff`` [m]. Returns ``(*B, 1)`` in (0, 1].

    Source: IV-D.2 (foot placement).
    """
    offset = instantaneous_capture_point(next_td) - next_td["base_position"][..., :2]
    offset = turn_to_heading(next_td["base_orientation"], offset)
    return rbf(offset, stance(robot).com, cutoff=cutoff, epsilon=epsilon)


def centered_zero_moment_point(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    cutoff: Positive,
    epsilon: OpenFraction,
) -> Tensor:
    """High when the zero-moment point lies in the middle of the footprints, on the floor or not.

    ``rbf(zmp, c)``, c being the center of the vertical projection of both soles, which is the
    mean of those of the soles: it moves ahead of a foot's touchdown.

    Reads ``feet_position`` ``(*B, 2, 3)`` [m] and what ``zero_moment_point`` reads; ``cutoff``
    [m]. Returns ``(*B, 1)`` in (0, 1].

    Source: IV-D.2 (dynamic stability).
    """
    center = next_td["feet_position"][..., :2].mean(-2)
    return rbf(zero_moment_point(next_td, robot.mass), center, cutoff=cutoff, epsilon=epsilon)
