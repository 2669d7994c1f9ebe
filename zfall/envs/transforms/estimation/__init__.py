"""What the robot's own computer works out from its sensors.

The Kalman filters run with the gain that they settle at: filterpy computes it once, by running the
filter until it does, and all worlds are then updated by one matrix product per step. After a reset
an estimate is the true value; that of the gyro's bias is 0, as of a robot just switched on: with a
bias of 0.02 rad/s the tilt is off by up to 0.04 rad in the first ten seconds.
"""

from zfall.envs.transforms.estimation.joint_velocity import (
    JointVelocityKalmanFilter,
    NumericalVelocity,
)
from zfall.envs.transforms.estimation.steady import steady_update
from zfall.envs.transforms.estimation.tilt import MahonyFilter, TiltKalmanFilter

__all__ = [
    "JointVelocityKalmanFilter",
    "MahonyFilter",
    "NumericalVelocity",
    "TiltKalmanFilter",
    "steady_update",
]
