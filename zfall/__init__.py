"""zfall: a small humanoid that learns to stay up when it is pushed, and to fall well."""

import os
import sys
from ctypes.util import find_library

import gymnasium

TASKS = (
    "atalante_standing",
    "icub_balance",
    "push_recovery",
    "push_recovery_realistic",
    "push_to_kneel",
    "zeroth_fall",
)  # the tables of recipes/env that gymnasium knows by name


def _choose_gl() -> None:
    """Picks an OpenGL without a screen for MuJoCo, which looks for one when it is imported."""
    if sys.platform != "linux" or os.environ.get("DISPLAY") or "MUJOCO_GL" in os.environ:
        return
    for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")):
        if find_library(library):
            os.environ["MUJOCO_GL"] = name
            return


def _register() -> None:
    """Tells gymnasium of ``zfall/PushRecovery-v0`` and its like; nothing is built yet."""
    for task in TASKS:
        gymnasium.register(
            f"zfall/{task.title().replace('_', '')}-v0",
            entry_point="zfall.envs.gym:TaskEnv",
            vector_entry_point="zfall.envs.gym:TaskVectorEnv",
            kwargs={"task": task},
        )


_choose_gl()
_register()
