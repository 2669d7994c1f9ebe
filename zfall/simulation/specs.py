"""Shapes, ranges and types of what the base env reads and writes."""

import torch
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded

from zfall.robots import Robot


def observation_spec(robot: Robot, num_envs: int, *, with_ball: bool) -> Composite:
    """Of all quantities, whose units and frames ``HumanoidEnv`` gives."""
    n, joints, regions = num_envs, len(robot.joints), len(robot.regions)
    shapes = {
        **dict.fromkeys(("joint_position", "joint_velocity", "joint_torque"), (joints,)),
        **dict.fromkeys(("base_position", "projected_gravity"), (3,)),
        **dict.fromkeys(("base_linear_velocity", "base_angular_velocity"), (3,)),
        **{"base_orientation": (4,), "base_acceleration": (3,), "base_acceleration_peak": (1,)},
        "joint_torque_peak": (1,),
        **dict.fromkeys(("com_position", "com_velocity"), (3,)),
        **dict.fromkeys(("linear_momentum", "angular_momentum"), (3,)),
        **dict.fromkeys(("feet_position", "feet_velocity", "feet_force"), (2, 3)),
        **{"feet_orientation": (2, 4), "feet_cop": (2, 2), "feet_corner_force": (2, 4)},
        **dict.fromkeys(("contact_force_peak", "contact_impulse"), (regions,)),
    }
    spec = Composite(
        {key: Unbounded((n, *shape)) for key, shape in shapes.items()}
        | {
            "feet_contact": Binary(2, shape=(n, 2), dtype=torch.bool),
            "diverged": Binary(1, shape=(n, 1), dtype=torch.bool),
        },
        shape=(n,),
    )
    if with_ball:
        for key in ("position", "velocity"):
            spec["ball", key] = Unbounded((n, 3))
    return spec


def action_spec(joint_range: Tensor, num_envs: int, substeps: int) -> Composite:
    """Of servo targets for each physics step, bounded by the joint ranges ``(J, 2)`` [rad]."""
    low, high = joint_range.unbind(-1)
    steps = torch.Size((num_envs, substeps, len(joint_range)))
    control = Bounded(low.expand(steps).clone(), high.expand(steps).clone(), steps)
    return Composite(control=control, shape=(num_envs,))


def done_spec(num_envs: int) -> Composite:
    """Of the flags that end an episode."""
    flags = ("done", "terminated", "truncated")
    return Composite(
        {key: Binary(1, shape=(num_envs, 1), dtype=torch.bool) for key in flags}, shape=(num_envs,)
    )
