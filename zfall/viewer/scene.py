"""What the browser shows of a robot: its bodies, a label, arrows of pushes."""

from collections.abc import Mapping

import mujoco
import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from zfall.simulation.model import push_point_bodies
from zfall.viewer.geometry import Poses, along, arrow

Array = NDArray[np.float64]

BEFORE = 0.1  # of a push point an arrow ends, so that its tip is not within the body [m]
LENGTH_PER_NEWTON = 0.01  # of an arrow [m/N], as in the films
LONGEST_ARROW = 0.6  # [m]
ABOVE = 0.3  # height of a label above the base [m]
COMPARED = (0.95, 0.55, 0.15)  # tint of robots that the policy is compared with


class RobotView:
    """One robot in the browser.

    Args:
        server: of viser.
        name: of its node in the scene, ``/world/robots/0``.
        model: the compiled model.
        meshes: what its bodies look like, as ``body_meshes`` gives them.
        offset: where the origin of its world is shown ``(3,)`` [m].
        label: text above it.

    Attributes:
        place: where it is in its own world ``(2,)`` [m].
        text: above it.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        name: str,
        model: mujoco.MjModel,
        meshes: Mapping[int, trimesh.Trimesh],
        offset: Array,
        label: str,
    ):
        self._server, self._name, self._offset = server, name, offset
        self._poses = Poses(model, list(meshes))
        self._nodes = [
            server.scene.add_mesh_trimesh(f"{name}/{model.body(body).name}", mesh)
            for body, mesh in meshes.items()
        ]
        self._label = server.scene.add_label(f"{name}/label", label)
        self._points: dict[str, Poses] = {}
        self._arrow: viser.SceneNodeHandle | None = None
        self._model, self._pushed, self._way = model, "", np.zeros(3)
        self.place, self.text = np.zeros(2), label

    def show(self, qpos: Array) -> None:
        """Moves the bodies to where they are in a state ``(nq,)``."""
        positions, quaternions = self._poses(qpos)
        self.place = positions[0, :2].copy()
        for node, position, quaternion in zip(self._nodes, positions, quaternions, strict=True):
            node.position, node.wxyz = position + self._offset, quaternion
        self._label.position = positions[0] + self._offset + np.array([0.0, 0.0, ABOVE])
        if self._arrow is not None:
            at = self._points[self._pushed](qpos)[0][0]
            self._arrow.position = at + self._offset - BEFORE * self._way

    def say(self, text: str) -> None:
        """Changes the text above it."""
        if text != self.text:
            self._label.text = self.text = text

    def show_push(self, point: str, force: Array) -> None:
        """Shows an arrow whose tip is a little before a push point, until ``hide_push``.

        Args:
            point: its name.
            force: ``(3,)`` [N; world].
        """
        self.hide_push()
        newtons = float(np.linalg.norm(force))
        if newtons == 0.0:
            return
        self._points.setdefault(point, Poses(self._model, [push_point_bodies(self._model)[point]]))
        self._pushed, self._way = point, force / newtons
        self._arrow = self._server.scene.add_mesh_trimesh(
            f"{self._name}/push",
            arrow(min(LENGTH_PER_NEWTON * newtons, LONGEST_ARROW)),
            wxyz=along(self._way),
        )

    def hide_push(self) -> None:
        """Takes the arrow away."""
        if self._arrow is not None:
            self._arrow.remove()
            self._arrow = None

    @property
    def pushed(self) -> bool:
        """Whether an arrow is shown."""
        return self._arrow is not None
