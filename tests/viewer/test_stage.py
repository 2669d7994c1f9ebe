"""The robots are in sight, on a screen and on a phone, and stay there when they walk."""

import math

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra [view] is not installed")

import viser

from zfall.viewer.page import Page
from zfall.viewer.stage import ARMS, FIELD, LEASH, Stage, offsets, viewpoint


def on_screen(points, position, aim, aspect):
    """Where a pinhole camera sees points, from -1 to 1 to the right and up."""
    ahead = (aim - position) / np.linalg.norm(aim - position)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead), ahead])
    x, y, depth = axes @ (points - position).T
    half = math.tan(FIELD / 2)
    return x / (half * aspect * depth), y / (half * depth)


@pytest.mark.parametrize("count", [1, 4, 16])
@pytest.mark.parametrize("aspect", [0.46, 0.5, 1.2, 1.78], ids=["long", "phone", "half", "wide"])
def test_all_robots_are_in_sight_next_to_the_panel_or_above_it(count, aspect):
    """Arms, heads and feet; a phone's panel covers the lower 60 %, that of a screen its right."""
    places = offsets(count)
    corners = [[0, side * 0.9 * ARMS, up] for side in (-1, 1) for up in (0.0, 0.5)]
    points = (places[:, None] + np.array(corners)).reshape(-1, 3)
    right, up = on_screen(points, *viewpoint(count, aspect), aspect)
    phone = aspect < 1
    assert np.abs(right).max() <= (1.0 if phone else 0.75)
    assert up.max() <= 1.0
    assert up.min() >= (0.2 if phone else -1.0)


@pytest.fixture(scope="module")
def server():
    page = Page("127.0.0.1", 0)
    yield page.server
    page.close()


def test_the_view_follows_a_robot_once_it_leaves_its_leash(server: viser.ViserServer):
    stage = Stage(server, 1)
    stage.follow(np.array([0.9 * LEASH, 0.0]))
    assert stage.center.tolist() == [0.0, 0.0]
    for _ in range(200):
        stage.follow(np.array([3.0, 4.0]))  # 5 m away
    np.testing.assert_allclose(stage.center, (1 - LEASH / 5) * np.array([3.0, 4.0]), atol=1e-6)
    stage.reset()
    assert stage.center.tolist() == [0.0, 0.0]


def test_a_closed_page_has_freed_its_port():
    page = Page("127.0.0.1", 0)
    port = page.port
    page.close()
    again = Page("127.0.0.1", port)
    again.close()
