"""Where the robots stand: a row on a floor, a camera for each browser, and a view that follows."""

import math

import numpy as np
import viser
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPACING = 0.55  # between two worlds [m]
ARMS = 0.4  # room for the arms of the outermost robots [m]
MIDDLE = 0.2  # height of the middle of a robot [m]
FIELD = 0.9  # that cameras see, up and down [rad]
PHONE = 0.8  # width over height: below it the panel covers the lower part of the page
NEXT_TO_PANEL = 0.72  # share of the width of wider pages that the panel leaves
ABOVE_PANEL = 0.6  # how far above the middle a phone shows robots, in halves of its height
LEASH = 0.4  # a robot may go so far before the view follows [m]
SHARE = 0.1  # of what it is too far, by which the view moves in a frame
ROOT = "/world"


class Stage:
    """The floor, and the world that is moved below the cameras to follow a robot.

    Args:
        server: of viser.
        count: number of robots that a new browser sees from the front.

    Attributes:
        center: the place of all worlds that is shown in the middle ``(2,)`` [m].
    """

    def __init__(self, server: viser.ViserServer, count: int):
        scene, self.center = server.scene, np.zeros(2)
        scene.set_up_direction("+z")
        self._world = scene.add_frame(ROOT, show_axes=False)
        self._floor = scene.add_grid(
            f"{ROOT}/floor", width=16.0, height=16.0, cell_size=0.25, section_size=1.0,
            cell_color=(208, 212, 217), section_color=(160, 166, 174),
        )  # fmt: skip

        @server.on_client_connect
        def look(client: viser.ClientHandle) -> None:
            position, aim = viewpoint(count, client.camera.aspect)
            client.camera.fov = FIELD
            client.camera.position, client.camera.look_at = position, aim

    def follow(self, place: Array) -> None:
        """Moves the view by a frame, if a place ``(2,)`` [m] is further away than the leash."""
        away = place - self.center
        distance = float(np.linalg.norm(away))
        if distance > LEASH:
            self._show(self.center + SHARE * (1 - LEASH / distance) * away)

    def reset(self) -> None:
        """Shows the place where all begin."""
        self._show(np.zeros(2))

    def _show(self, center: Array) -> None:
        self.center = center
        self._world.position = (-center[0], -center[1], 0.0)
        self._floor.position = (*np.round(center), 0.0)  # by whole sections: it seems to lie still


def offsets(count: int) -> Array:
    """Where worlds are shown ``(count, 3)`` [m]: in a row along y.

    The first is at the left for who looks at their faces.
    """
    places = np.zeros((count, 3))
    places[:, 1] = SPACING * (np.arange(count) - (count - 1) / 2)
    return places


def viewpoint(count: int, aspect: float) -> tuple[Array, Array]:
    """Where a camera stands, and what it looks at, each ``(3,)`` [m], to see all robots.

    Args:
        count: number of robots.
        aspect: width over height of the page. On a phone the robots are shown above the panel.
    """
    half = math.tan(FIELD / 2)
    free = aspect if aspect < PHONE else NEXT_TO_PANEL * aspect
    away = max(1.6, (SPACING * (count - 1) / 2 + ARMS) / (half * free))
    height = 0.35 + 0.3 * away
    position = np.array([away, 0.0, height])
    if aspect >= PHONE:
        return position, np.array([0.0, 0.0, MIDDLE])
    down = math.atan((height - MIDDLE) / away) + math.atan(ABOVE_PANEL * half)
    return position, np.array([away - height / math.tan(down), 0.0, 0.0])  # on the floor
