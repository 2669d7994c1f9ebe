"""How an episode begins."""

from zfall.envs.transforms.starts.noisy import NoisyStart
from zfall.envs.transforms.starts.reference import ReferenceStart
from zfall.envs.transforms.starts.scripted import ScriptedStart

__all__ = ["NoisyStart", "ReferenceStart", "ScriptedStart"]
