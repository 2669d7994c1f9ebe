"""What the browser shows: floor, robots with labels, arrows of pushes."""

import mujoco
import numpy as np
import viser
from numpy.typing import NDArray

from zfall.viewer.geometry import Poses, along, arrow, body_meshes

Array = NDArray[np.float64]

SPACING = 0.7  # between two worlds [m]
LENGTH_PER_NEWTON = 0.01  # of an arrow [m/N], as in the films
LONGEST_ARROW = 0.6  # [m]
ABOVE = 0.3  # height of a label above the base [m]
COMPARED = (0.95, 0.55, 0.15)  # tint of robots that the policy is compared with


class RobotView:
    """One robot in the browser.

    Args:
        server: of viser.
        name: of its node in the scene, ``/robots/0``.
        model: the compiled model.
        offset: where the origin of its world is shown ``(3,)`` [m].
        label: text above it.
        compared: whether it is tinted as one that the policy is compared with.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        name: str,
        model: mujoco.MjModel,
        offset: Array,
        label: str,
        *,
        compared: bool = False,
    ):
        self._server, self._name, self._offset = server, name, offset
        meshes = body_meshes(model, COMPARED if compared else None)
        self._poses = Poses(model, list(meshes))
        self._nodes = [
            server.scene.add_mesh_trimesh(f"{name}/{model.body(body).name}", mesh)
            for body, mesh in meshes.items()
        ]
        self._label = server.scene.add_label(f"{name}/label", label)
        self._points: dict[str, Poses] = {}
        self._arrow: viser.SceneNodeHandle | None = None
        self._model, self._pushed = model, ""
        self.text = label

    def show(self, qpos: Array) -> None:
        """Moves the bodies to where they are in a state ``(nq,)``."""
        positions, quaternions = self._poses(qpos)
        for node, position, quaternion in zip(self._nodes, positions, quaternions, strict=True):
            node.position, node.wxyz = position + self._offset, quaternion
        self._label.position = positions[0] + self._offset + np.array([0.0, 0.0, ABOVE])
        if self._arrow is not None:
            at = self._points[self._pushed](qpos)[0][0]
            self._arrow.position = at + self._offset

    def say(self, text: str) -> None:
        """Changes the text above it."""
        if text != self.text:
            self._label.text = self.text = text

    def show_push(self, point: str, body: int, force: Array) -> None:
        """Shows an arrow whose tip is at a push point, until ``hide_push``.

        Args:
            point: its name.
            body: its number among the bodies of the model.
            force: ``(3,)`` [N; world].
        """
        self.hide_push()
        newtons = float(np.linalg.norm(force))
        if newtons == 0.0:
            return
        self._points.setdefault(point, Poses(self._model, [body]))
        self._pushed = point
        self._arrow = self._server.scene.add_mesh_trimesh(
            f"{self._name}/push",
            arrow(min(LENGTH_PER_NEWTON * newtons, LONGEST_ARROW)),
            wxyz=along(force / newtons),
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


def offsets(count: int) -> Array:
    """Where worlds are shown ``(count, 3)`` [m]: in a row along y.

    The first is at the left for who looks at their faces.
    """
    places = np.zeros((count, 3))
    places[:, 1] = SPACING * (np.arange(count) - (count - 1) / 2)
    return places


def furnish(server: viser.ViserServer, count: int) -> None:
    """Puts up the floor and lets every new browser look at ``count`` robots from the front."""
    scene = server.scene
    scene.set_up_direction("+z")
    scene.add_grid(
        "/floor", width=12.0, height=12.0, cell_size=0.25, section_size=1.0,
        cell_color=(215, 218, 222), section_color=(170, 175, 182),
    )  # fmt: skip
    away = max(1.5, 0.45 * SPACING * count + 0.4)

    @server.on_client_connect
    def look(client: viser.ClientHandle) -> None:
        client.camera.position = (away, 0.0, 0.25 + 0.3 * away)
        client.camera.look_at = (0.0, 0.0, 0.2)
