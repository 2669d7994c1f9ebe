"""How an episode begins."""

from zfall.envs.transforms.starts.kneeling import FallingStart, KneelStart
from zfall.envs.transforms.starts.reference import ReferenceStart
from zfall.envs.transforms.starts.scripted import NoisyStart, ScriptedStart

__all__ = ["FallingStart", "KneelStart", "NoisyStart", "ReferenceStart", "ScriptedStart"]
