"""Where hydra looks for plugins; it is no package of ours, and many packages add modules to it."""

from zfall.cluster.launcher import RayLauncher

__all__ = ["RayLauncher"]
