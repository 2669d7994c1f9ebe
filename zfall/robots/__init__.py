"""Robots as data: what an MJCF cannot say, and the robot that ships."""

from zfall.robots.ball import Ball
from zfall.robots.robot import GRAVITY, PushPoint, Robot
from zfall.robots.zeroth01 import ZEROTH01

__all__ = ["GRAVITY", "ZEROTH01", "Ball", "PushPoint", "Robot"]
