"""Pictures of the robot, without a screen."""

import os
from collections.abc import Callable
from functools import cached_property
from importlib import import_module, reload
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

INSTALL = (
    "apt-get install libegl1 libgl1-mesa-dri (or libosmesa6), and set MUJOCO_GL=egl (or osmesa)"
)


def make_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """A renderer without a screen.

    Raises:
        RuntimeError: if no OpenGL is to be had, naming what to install, or what to set.
    """
    if refused := os.environ.get("ZFALL_REFUSED_GL"):
        raise RuntimeError(
            f"MUJOCO_GL must be egl, osmesa or glfw for pictures, or not be set, got {refused}."
        )
    try:
        _choose_again()
        return mujoco.Renderer(model, height, width)
    except Exception as error:
        raise RuntimeError(
            f"rendering needs OpenGL without a screen; install: {INSTALL}"
        ) from error


def _choose_again() -> None:
    """Lets MuJoCo see what MUJOCO_GL says now, if TorchRL imported it before zfall had set it."""
    chosen: Any = import_module("mujoco.rendering.classic.gl_context")
    if getattr(chosen, "_MUJOCO_GL", "") != os.environ.get("MUJOCO_GL", "").lower().strip():
        reload(chosen)


class Camera:
    """Takes pictures by the MJCF's camera ``track``, with a renderer that it makes for the first.

    Args:
        compile_look: makes the model to show, which may look other than what is stepped but has
            the same state; called when the first picture is taken.
    """

    _renderer: Any

    def __init__(self, compile_look: Callable[[], mujoco.MjModel]):
        self._compile_look, self._renderer = compile_look, None
        self._size = (0, 0)

    @cached_property
    def model(self) -> mujoco.MjModel:
        """What is shown."""
        return self._compile_look()

    def picture(
        self, qpos: NDArray[np.float64], height: int = 480, width: int = 640
    ) -> NDArray[np.uint8]:
        """One picture ``(height, width, 3)``.

        Args:
            qpos: a state ``(nq,)`` in MuJoCo's order.
            height, width: of the picture [pixels].

        Raises:
            RuntimeError: if no OpenGL is to be had.
        """
        if self._size != (height, width):
            self.close()
            self._renderer = make_renderer(self.model, width, height)
            self._data, self._size = mujoco.MjData(self.model), (height, width)
        place(self.model, self._data, qpos)
        self._renderer.update_scene(self._data, camera="track")
        return self._renderer.render()

    def pictures(self, states: NDArray[np.float64], height: int, width: int) -> NDArray[np.uint8]:
        """One picture of each of the ``states`` ``(N, nq)``, ``(N, height, width, 3)``."""
        return np.stack([self.picture(qpos, height, width) for qpos in states])

    def close(self) -> None:
        """Frees the renderer; the next picture makes a new one."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer, self._size = None, (0, 0)

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles make their own renderer."""
        return {"_compile_look": self._compile_look}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["_compile_look"])  # type: ignore[misc]


def place(model: mujoco.MjModel, data: mujoco.MjData, qpos: NDArray[np.float64]) -> None:
    """Puts all that a picture shows where a state ``(nq,)`` has it."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)  # which the camera follows
    mujoco.mj_camlight(model, data)
