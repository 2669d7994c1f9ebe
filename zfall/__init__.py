"""zfall: a small humanoid that learns to stay up when it is pushed, and to fall well."""

import os
import sys
from ctypes.util import find_library


def _choose_gl() -> None:
    """Picks an OpenGL without a screen for MuJoCo, which looks for one when it is imported."""
    if sys.platform != "linux" or os.environ.get("DISPLAY") or "MUJOCO_GL" in os.environ:
        return
    for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")):
        if find_library(library):
            os.environ["MUJOCO_GL"] = name
            return


_choose_gl()
