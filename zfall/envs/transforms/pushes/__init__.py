"""Disturbances: forces over time, a kick of the velocity, a thrown ball."""

from zfall.envs.transforms.pushes.ball import ThrownBall
from zfall.envs.transforms.pushes.ball_push import BallPush
from zfall.envs.transforms.pushes.kick import VelocityKick
from zfall.envs.transforms.pushes.random import RandomPush
from zfall.envs.transforms.pushes.scripted import ScriptedPush

__all__ = ["BallPush", "RandomPush", "ScriptedPush", "ThrownBall", "VelocityKick"]
