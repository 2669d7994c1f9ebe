"""What the loop asks of a robot: registers of its servos, an IMU, a clock."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

STEPS = 4096  # of the encoder in a turn
MIDDLE = 2048  # the encoder's reading at angle 0


class Register(NamedTuple):
    """A register of Feetech's STS servos.

    Attributes:
        address: in the servo's memory.
        size: in bytes, low byte first.
        largest: value that it takes; the smallest is 0.
    """

    address: int
    size: int
    largest: int


KP = Register(0x15, 1, 254)
TORQUE_ENABLE = Register(0x28, 1, 1)
ACCELERATION = Register(0x29, 1, 254)  # of the ramp, in 100 steps/s2; 0 is no ramp
GOAL_POSITION = Register(0x2A, 2, STEPS - 1)
TORQUE_LIMIT = Register(0x30, 2, 1000)  # in thousandths
PRESENT_POSITION = Register(0x38, 2, STEPS - 1)
PRESENT_VOLTAGE = Register(0x3E, 1, 255)  # in tenths of a volt
PRESENT_TEMPERATURE = Register(0x3F, 1, 255)  # [degree Celsius]
CEILING = Register(0x55, 1, 254)  # of the ramp, whatever ACCELERATION says; 50 as it is sold
# The first five lie in RAM or are used from there: they are written at each start.


class Bus(Protocol):
    """A robot: its servos by the names of its joints, its IMU, and its clock.

    Ids, directions and zeros of the servos, and the axes of the IMU, are the bus's own matter.

    Attributes:
        robot: name of the robot.
        joints: names of its joints.
        quantities: what ``sense`` measures.
    """

    robot: str
    joints: Sequence[str]
    quantities: Sequence[str]

    def now(self) -> float:
        """Time since the bus was opened [s]."""

    def wait_until(self, time: float) -> None:
        """Returns at a time [s]; at once if it is over."""

    def write(self, register: Register, values: Mapping[str, int]) -> None:
        """Writes a register of some servos, by joint, in one packet."""

    def read(self, register: Register, joints: Sequence[str]) -> dict[str, int]:
        """Reads a register of some servos: of those that answer in time, by joint."""

    def sense(self) -> Mapping[str, NDArray[np.float32]]:
        """What is measured besides the servos, by name, in the units of ``policy.json``."""

    def close(self) -> None:
        """Lets go of the hardware."""


def to_steps(angle: float) -> int:
    """An angle [rad] as the register has it, cut off at the ends of its turn."""
    steps = round(angle * STEPS / math.tau) + MIDDLE
    return min(max(steps, 0), STEPS - 1)


def to_angle(steps: int) -> float:
    """The angle of a register's value [rad]."""
    return (steps - MIDDLE) * math.tau / STEPS
