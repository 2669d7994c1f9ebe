"""Quantities over time, for terms, which have no memory."""

from zfall.envs.transforms.windows.feet_air_time import FeetAirTime
from zfall.envs.transforms.windows.joint_effort import JointEffort
from zfall.envs.transforms.windows.joint_error_min import JointErrorMin
from zfall.envs.transforms.windows.joint_power import JointPower
from zfall.envs.transforms.windows.joint_stop_speed import JointStopSpeed
from zfall.envs.transforms.windows.largest_so_far import LargestSoFar
from zfall.envs.transforms.windows.last_action import LastAction
from zfall.envs.transforms.windows.mean_velocity import MeanVelocity
from zfall.envs.transforms.windows.momentum_rate import MomentumRate
from zfall.envs.transforms.windows.moving_average import MovingAverage
from zfall.envs.transforms.windows.odometry_displacement import OdometryDisplacement

__all__ = [
    "FeetAirTime",
    "JointEffort",
    "JointErrorMin",
    "JointPower",
    "JointStopSpeed",
    "LargestSoFar",
    "LastAction",
    "MeanVelocity",
    "MomentumRate",
    "MovingAverage",
    "OdometryDisplacement",
]
