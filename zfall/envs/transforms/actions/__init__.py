"""From the policy's action to the servos' commands.

First in the table stands what turns the action into targets, ``JointPositionTarget`` or
``JointVelocityTarget``. A transform that moves the reference of the targets follows. The rest
stands for the way to the motors and for the motors' own firmware; each takes the commands of all S
physics steps from the one before it.
"""

from zfall.envs.transforms.actions.actuator_delay import ActuatorDelay
from zfall.envs.transforms.actions.hysteresis import Backlash, Deadband
from zfall.envs.transforms.actions.joint_position_target import JointPositionTarget
from zfall.envs.transforms.actions.joint_velocity_target import JointVelocityTarget
from zfall.envs.transforms.actions.low_pass import LowPass
from zfall.envs.transforms.actions.servo_planner import ServoPlanner

__all__ = [
    "ActuatorDelay",
    "Backlash",
    "Deadband",
    "JointPositionTarget",
    "JointVelocityTarget",
    "LowPass",
    "ServoPlanner",
]
