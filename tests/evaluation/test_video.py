"""Films, where OpenGL is to be had."""

import imageio.v2 as imageio
import mujoco
import numpy as np
import pytest

from zfall.evaluation import video
from zfall.robots import ZEROTH01


def test_film_has_a_frame_per_step_and_shows_the_robot(tmp_path):
    model = mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)
    states = np.tile(model.key("stand").qpos, (5, 2, 1))
    forces = np.zeros((5, 2, 3))
    forces[2:, 0] = [20.0, 0.0, 0.0]
    path = tmp_path / "film.mp4"
    try:
        video.film(model, {"a": states}, ["one", "two"], forces, path, dt=0.04, tile=(160, 120))
    except RuntimeError as error:
        assert "install" in str(error)
        pytest.skip("no OpenGL on this machine")
    frames = imageio.mimread(path)
    assert len(frames) == 5
    assert frames[0].std() > 10
    assert np.abs(frames[4].astype(int) - frames[0]).max() > 50  # the arrow


def test_missing_opengl_says_what_to_install(monkeypatch):
    def broken(*args: object) -> None:
        raise OSError("no display")

    monkeypatch.setattr(mujoco, "Renderer", broken)
    with pytest.raises(RuntimeError, match="install: apt-get install libegl1"):
        video.make_renderer(mujoco.MjModel.from_xml_path(ZEROTH01.mjcf), 8, 8)
