"""Quantities over time, for terms that have no memory of their own."""

from zfall.envs.transforms.windows.last_action import LastAction

__all__ = ["LastAction"]
