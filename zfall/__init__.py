"""zfall: a small humanoid that learns to stay up when it is pushed, and to fall well."""

import os
import sys
from ctypes.util import find_library
from importlib import import_module
from typing import Any

import gymnasium

from zfall.configs import options_of

__version__ = "0.2.0"


def _spin_briefly() -> None:
    """Lets torch's threads wait for each other without spinning for long; read as torch is loaded.

    By default they spin for milliseconds: beside any other work on the same cores a pass over a
    batch then takes ten times as long and more. Alone on the machine it makes no difference.
    """
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")


# What MuJoCo and dm_control both take; they raise at import for anything else.
_GL = (
    "",
    "0",
    "1",
    "disable",
    "disabled",
    "egl",
    "enable",
    "enabled",
    "false",
    "glfw",
    "off",
    "on",
)


def _choose_gl() -> None:
    """Picks an OpenGL without a screen for MuJoCo, which looks for one when it is imported.

    A value that MuJoCo does not know is put aside: what needs no pictures works without, and what
    does says so, see ``zfall.envs.rendering``. EGL and OSMesa are of Linux alone: elsewhere their
    names are dropped, and MuJoCo takes what its system has.
    """
    given = os.environ.get("MUJOCO_GL", "")
    if sys.platform != "linux" and given.lower().strip() in ("egl", "osmesa"):
        del os.environ["MUJOCO_GL"]
        return
    if given.lower().strip() not in (*_GL, "osmesa", "true"):
        os.environ |= {"MUJOCO_GL": "disable", "ZFALL_REFUSED_GL": given}
    if sys.platform != "linux" or os.environ.get("DISPLAY") or "MUJOCO_GL" in os.environ:
        return
    for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")):
        if find_library(library):
            os.environ["MUJOCO_GL"] = name
            return


def _register() -> None:
    """Tells gymnasium of ``zfall/PushRecovery-v0`` and its like; nothing is built yet."""
    for task in options_of("env"):
        gymnasium.register(
            f"zfall/{task.title().replace('_', '')}-v0",
            entry_point="zfall.envs.gym:TaskEnv",
            vector_entry_point="zfall.envs.gym:TaskVectorEnv",
            kwargs={"task": task},
        )


def __getattr__(name: str) -> Any:
    """``zfall.load_policy`` and ``zfall.Policy``: torch is loaded when they are asked for."""
    if name in ("Policy", "load_policy"):
        return getattr(import_module("zfall.policies"), name)
    raise AttributeError(f"module zfall has no attribute {name}")


_spin_briefly()
_choose_gl()
_register()
