"""Joints by their names: other frameworks number them in other orders.

PhysX, and with it Isaac Lab, goes through the tree of links breadth first, MuJoCo depth first. Only
the names tell which number belongs to which joint.
"""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.robots import Robot
from zfall.values import NamesOf

OF_ROBOT = NamesOf("joints of the robot", lambda robot: robot.joints)


def places(robot: Robot, names: Sequence[str], key: str = "joints") -> Tensor:
    """Where joints stand in the robot's order ``(len(names),)``.

    Args:
        robot: the robot.
        names: of its joints, each once.
        key: where they are named, for messages.

    Raises:
        ValueError: on a joint that it lacks, naming the nearest, or one that is named twice.
    """
    OF_ROBOT.check(key, names, robot)
    twice = [name for name in names if list(names).count(name) > 1]
    if twice:
        raise ValueError(f"{key} must name each joint once, got {twice[0]} twice.")
    return torch.tensor([robot.joints.index(name) for name in names])


def reference_pose(env: HumanoidEnv, reference: Mapping[str, float]) -> Tensor:
    """The pose ``(J,)`` [rad] that actions and positions start from.

    Args:
        env: the base env.
        reference: angles by joint [rad]; all others are those of the robot's stand.

    Raises:
        ValueError: on a joint that the robot lacks.
    """
    pose = env.stand_position.clone()
    if reference:
        pose[places(env.robot, list(reference), "reference")] = torch.tensor(
            [*reference.values()], dtype=pose.dtype
        )
    return pose
