"""Actuators made from servos, natively: what MuJoCo then does in every physics step."""

from collections.abc import Mapping

import mujoco

from zfall.robots import Robot
from zfall.robots.servos import Servo


def put_servos(spec: mujoco.MjSpec, robot: Robot, servos: Mapping[str, Servo]) -> None:
    """Gives each joint of a robot its servo, see ``put_servo``.

    Raises:
        ValueError: if a joint has none, what has one is no joint, or a servo lacks a value.
    """
    if not isinstance(servos, Mapping):
        raise ValueError(f"servos must be a table of joints and their servos, got {servos}.")
    lacking = [joint for joint in robot.joints if servos.get(joint) is None]
    unknown = [str(joint) for joint in servos if joint not in robot.joints]
    if lacking or unknown:
        found = f"lacks {', '.join(lacking)}" if lacking else f"also has {', '.join(unknown)}"
        raise ValueError(f"servos must have a servo for each joint of {robot.name}, {found}.")
    for joint in robot.joints:
        if not isinstance(servos[joint], Servo):
            raise ValueError(f"servos.{joint} must be a Servo, got {servos[joint]}.")
        try:
            put_servo(spec, joint, servos[joint])
        except ValueError as error:
            raise ValueError(f"servos.{joint}: {error}") from error


def put_servo(spec: mujoco.MjSpec, joint: str, servo: Servo) -> None:
    """Makes the actuator of a joint, its damping, dry friction and inertia those of a servo.

    A position actuator clips stiffness times error at the motor's torque. The joint's damping is
    the back-EMF: it acts beyond the clip, as in a motor that a voltage drives. All of it at the
    voltage of the sheet; what a battery gives is a factor on the first two.

    Args:
        spec: with an actuator of the joint's name.
        joint: its name.
        servo: the servo.

    Raises:
        ValueError: if the servo's friction or inertia is not known.
    """
    actuator, hinge = spec.actuator(joint), spec.joint(joint)
    actuator.set_to_position(kp=servo.stiffness())
    actuator.forcelimited = True
    actuator.forcerange = [-servo.motor_torque(), servo.motor_torque()]
    hinge.damping[0] = servo.damping
    hinge.frictionloss, hinge.armature = servo.need("friction"), servo.need("armature")
