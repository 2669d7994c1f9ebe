"""Robots as data: an MJCF, what it cannot say, and the robot that ships."""

from zfall.robots.ball import Ball
from zfall.robots.completion import bare_model, full_spec, let_feet_decide
from zfall.robots.contact import Contact
from zfall.robots.robot import GRAVITY, PushPoint, Robot
from zfall.robots.zeroth01 import ZEROTH01

DEFAULT = ZEROTH01  # what an env has that names no robot

__all__ = ["DEFAULT", "GRAVITY", "ZEROTH01", "Ball", "Contact", "PushPoint", "Robot",
           "bare_model", "full_spec", "let_feet_decide"]  # fmt: skip
