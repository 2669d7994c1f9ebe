"""What counts at rest alone: a robot that nobody pushes is to stand still, with idle servos.

Each of these is multiplied by ``at_rest``, so that it asks for nothing while the robot saves
itself.
"""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.balance import capture_point
from zfall.robots import Robot
from zfall.values import Name, Names, Positive


def at_rest(td: TensorDictBase, next_td: TensorDictBase, *, reach: Positive) -> Tensor:
    """Near 1 while the robot could stop where it is, on both feet: ``exp(-|xi|^2 / reach^2)``.

    xi is the capture point of ``balance.capture_point``; 0 unless both feet touch the floor.
    Reads what that reads, and ``feet_contact`` ``(*B, 2)``; ``reach`` [m]. Returns ``(*B, 1)`` in
    [0, 1].
    """
    value = capture_point(td, next_td, sigma=reach)
    return torch.where(next_td["feet_contact"].all(-1, keepdim=True), value, 0.0)


def still_joints(
    td: TensorDictBase, next_td: TensorDictBase, *, reach: Positive, sigma: Positive
) -> Tensor:
    """High while joints stand still at rest: ``at_rest exp(-mean(speed^2) / sigma^2)``.

    Reads ``joint_velocity`` ``(*B, J)`` [rad/s] and what ``at_rest`` reads; ``reach`` [m],
    ``sigma`` [rad/s]. Returns ``(*B, 1)`` in [0, 1].
    """
    return _calm(next_td["joint_velocity"], sigma) * at_rest(td, next_td, reach=reach)


def still_actions(
    td: TensorDictBase, next_td: TensorDictBase, *, reach: Positive, sigma: Positive
) -> Tensor:
    """High while the action stays at rest: ``at_rest exp(-mean(change^2) / sigma^2)``.

    The change is that from ``last_action`` to ``action`` ``(*B, J)`` before the step, without
    unit, like ``sigma``. Reads what ``at_rest`` reads besides; ``reach`` [m]. Returns ``(*B, 1)``
    in [0, 1].
    """
    change = td["action"] - td["last_action"]
    return _calm(change, sigma) * at_rest(td, next_td, reach=reach)


def idle_servos(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    reach: Positive,
    sigma: Positive,
    torque: Name = "joint_torque",
) -> Tensor:
    """High while servos carry little at rest: ``at_rest exp(-mean(torque^2) / sigma^2)``.

    Reads ``torque`` ``(*B, J)`` [N m] and what ``at_rest`` reads; ``reach`` [m], ``sigma`` [N m].
    Exploration moves ``joint_torque`` by more than what a standing robot carries; a
    ``MovingAverage`` of it shows that. Returns ``(*B, 1)`` in [0, 1].
    """
    return _calm(next_td[torque], sigma) * at_rest(td, next_td, reach=reach)


def busiest_servo(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    reach: Positive,
    sigma: Positive,
    torque: Name = "joint_torque",
) -> Tensor:
    """High while no servo carries much at rest: ``at_rest exp(-max(torque^2) / sigma^2)``.

    Like ``idle_servos``, but of the servo that carries most: legs that press against each other
    load few servos, which a mean over all hardly shows. ``sigma`` [N m]. Returns ``(*B, 1)`` in
    [0, 1].
    """
    largest = next_td[torque].abs().amax(-1, keepdim=True)
    return _calm(largest, sigma) * at_rest(td, next_td, reach=reach)


def rest_posture(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    reach: Positive,
    sigma: Positive,
    offsets: Mapping[str, float] | None = None,
    joints: Names | None = None,
) -> Tensor:
    """High in a pose to rest in: ``at_rest exp(-mean((q - q0 - offset)^2) / sigma^2)``.

    Reads ``joint_position`` ``(*B, J)`` [rad] and what ``at_rest`` reads; ``reach`` [m],
    ``sigma`` [rad]. Returns ``(*B, 1)`` in [0, 1].

    Args:
        td: before the step.
        next_td: after it.
        robot: whose standing reference pose is q0.
        reach: of the capture point, see ``at_rest``.
        sigma: root mean square over joints at which it has fallen to 1/e.
        offsets: of the pose from q0, by joint [rad]; joints that are not named have none.
        joints: over which the mean is; ``None``: all.

    Raises:
        ValueError: if the robot has no such joint, or one with an offset does not count.
    """
    offsets = offsets or {}
    for argument, names in {"offsets": offsets, "joints": joints or ()}.items():
        for name in names:
            if name not in robot.joints:
                raise ValueError(f"{argument} must name joints of {robot.name}, got {name}.")
    for name in offsets if joints else ():
        if name not in (joints or ()):
            raise ValueError(f"offsets must be of joints that count, {name} is none of joints.")
    position = next_td["joint_position"]
    pose = position.new_tensor(robot.stand_position)
    pose = pose + position.new_tensor([offsets.get(name, 0.0) for name in robot.joints])
    away = position - pose
    if joints is not None:
        away = away[..., [robot.joints.index(name) for name in joints]]
    return _calm(away, sigma) * at_rest(td, next_td, reach=reach)


def _calm(value: Tensor, sigma: float) -> Tensor:
    return torch.exp(-value.square().mean(-1, keepdim=True) / sigma**2)
