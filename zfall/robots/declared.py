"""What a robot declares, held against its compiled model."""

from functools import cache

import mujoco
import numpy as np

from zfall.robots.completion import bare_model
from zfall.robots.derivation import settled_height
from zfall.robots.refusals import check_gravity
from zfall.robots.robot import Robot
from zfall.robots.symmetry import Symmetry, asymmetry

# Largest differences that are roundings of what is typed, and what no robot is without.
_MASS, _HEIGHT = 1e-3, 0.01  # shares
_ANGLE = 1e-3  # of the keyframe ``stand`` [rad]
_ASYMMETRY = 0.05  # of the robot's size


@cache
def check_declared(robot: Robot) -> None:
    """Refuses a robot whose numbers are not those of its MJCF; looks once at each robot.

    Raises:
        ValueError: naming what was declared, and what the model says.
    """
    model = bare_model(robot)
    try:
        check_gravity(model)
    except ValueError as error:
        raise ValueError(f"{robot.mjcf}: {error}.") from None
    _check(robot, "mass", robot.mass, float(model.body_mass.sum()), _MASS, "kg")
    _check_stand(robot, model)
    _check(robot, "com_height", robot.com_height, _height(robot, model), _HEIGHT, "m")
    if robot.mirror:
        _check_mirror(robot, model)


def _check(robot: Robot, name: str, declared: float, found: float, share: float, unit: str) -> None:
    if not abs(declared - found) <= share * abs(found):
        raise ValueError(
            f"{name} of {robot.name} must be that of its MJCF, {found:.4g} {unit}, got "
            f"{declared:.4g} {unit}; left out, it is derived."
        )


def _height(robot: Robot, model: mujoco.MjModel) -> float:
    if "derived" in vars(robot):  # it has settled already
        return robot.derived.com_height
    try:
        return settled_height(model)
    except ValueError as error:
        raise ValueError(f"{robot.mjcf}: {error}.") from None


def _check_stand(robot: Robot, model: mujoco.MjModel) -> None:
    qpos = model.key("stand").qpos
    for joint, angle in zip(robot.joints, robot.stand_position, strict=True):
        found = float(qpos[model.joint(joint).qposadr[0]])
        if abs(found - angle) > _ANGLE:
            raise ValueError(
                f"stand of {robot.name} must be the keyframe 'stand' of its MJCF, where {joint} is "
                f"at {found:.4g} rad, got {angle:.4g} rad."
            )


def _check_mirror(robot: Robot, model: mujoco.MjModel) -> None:
    mirror = Symmetry(robot.mirror_index, robot.mirror_sign)
    if (apart := asymmetry(model, robot.joints, mirror)) > _ASYMMETRY or np.isnan(apart):
        raise ValueError(
            f"mirror of {robot.name} must exchange its sides: mirrored poses differ by "
            f"{100 * apart:.0f} % of its size; left out, it is derived."
        )
