"""Servos as data: what makers' sheets and public tests say of them, and what follows from it."""

from zfall.robots.servos.datasheets import SERVOS, STS3215, STS3250, XL330_M288, servo
from zfall.robots.servos.servo import Overload, Servo

__all__ = ["SERVOS", "STS3215", "STS3250", "XL330_M288", "Overload", "Servo", "servo"]
