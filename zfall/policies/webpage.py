"""The robot of a task for a program without zfall: its MJCF, and what that cannot say."""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from zfall.envs.humanoid import HumanoidEnv
from zfall.simulation.model import (
    FIELDS,
    identity_of,
    model_spec,
    name_in_region,
    push_point_bodies,
)

# What playground/world.js can measure.
MEASURABLE = (
    *("projected_gravity", "base_position", "base_orientation", "base_linear_velocity"),
    *("base_angular_velocity", "base_acceleration", "joint_position", "joint_velocity"),
    *("com_position", "com_velocity", "angular_momentum", "feet_position", "feet_velocity"),
    *("feet_orientation", "feet_force", "feet_contact", "imu_orientation", "command"),
)


def robot_mjcf(env: HumanoidEnv) -> str:
    """The MJCF of the env's robot with its servos and push points, for MuJoCo 3.9 and later.

    Its numbers have six digits; ``describe_robot`` has them all.

    Args:
        env: the base env.

    Raises:
        ValueError: if its physics is more than MuJoCo's own.
    """
    if env.servo_dynamics is not None:
        raise ValueError(
            "run must have no servo_dynamics to be played without zfall: "
            "'change=[base_env.servo_dynamics=false]'."
        )
    if env.ball is not None:
        raise ValueError("run must have no ball to be played without zfall: base_env.ball=null.")
    spec = model_spec(env.robot, physics_dt=env.physics_dt, servos=env.servos)
    spec.compile()
    # What position servos read is an attribute since 3.17; before, they know nothing else.
    text: str = spec.to_xml()
    return text.replace(' input="pos"', "")


def describe_robot(env: HumanoidEnv) -> dict[str, Any]:
    """What ``robot_mjcf`` does not say: the content of ``robot.json``.

    ``fields`` has the values of ``mjModel`` with all digits, to be put into the loaded model;
    ``falls`` the contact sensors of all regions but the feet: a force there is a fall.

    Args:
        env: the base env.
    """
    robot, model = env.robot, env.simulation.model
    sensors = [model.sensor(i).name for i in range(model.nsensor)]
    soles = [model.sensor(f"feet_position/{foot}") for foot in robot.feet]
    sites = [model.site(int(sole.objid[0])) for sole in soles]
    feet = np.isin(model.geom_bodyid, [int(site.bodyid[0]) for site in sites])
    return {
        "robot": robot.name,
        "identity": identity_of(robot),
        "mujoco": mujoco.__version__,
        "joints": list(robot.joints),
        "feet": list(robot.feet),
        "soles": [site.name for site in sites],
        "sole_half_size_m": list(robot.sole_half_size),
        "foot_geoms": np.flatnonzero(feet).tolist(),
        "push_points": {name: model.body(i).name for name, i in push_point_bodies(model).items()},
        "impulse_unit_ns": robot.impulse_unit,
        "com_height_m": robot.com_height,
        "falls": [s for s in sensors if any(name_in_region(s, r) for r in robot.regions[:-2])],
        "fields": {
            name: value.ravel().tolist()
            for name in FIELDS
            if (value := getattr(model, name)).dtype == np.float64
        },
    }


def check_measurable(about: Mapping[str, Any]) -> None:
    """Refuses a policy that reads what the page does not measure.

    Args:
        about: content of ``policy.json``.

    Raises:
        ValueError: naming it.
    """
    for sensor in about["sensors"]:
        if sensor["name"] not in MEASURABLE:
            raise ValueError(
                f"run must read what the page measures: {', '.join(MEASURABLE)}; "
                f"got {sensor['name']}."
            )
