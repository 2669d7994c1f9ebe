"""Plots are written and not empty."""

import imageio.v2 as imageio
import numpy as np
import pandas as pd

from zfall.evaluation.plots import learning_curves, success_map


def test_success_map_shows_success_and_failure_in_other_colors(tmp_path):
    rows = [
        {"direction_rad": d, "impulse": i, "recovered": i < 0.3}
        for d in np.arange(0, 2 * np.pi, np.pi / 6)
        for i in (0.0, 0.1, 0.2, 0.3, 0.4)
    ]
    success_map(pd.DataFrame(rows), tmp_path / "map.png", title="test", baseline=pd.DataFrame(rows))
    picture = imageio.imread(tmp_path / "map.png")
    colors = {tuple(c) for c in picture.reshape(-1, picture.shape[-1])[:, :3]}
    assert len(colors) > 10


def test_learning_curves_are_drawn(tmp_path):
    columns = ("frames", "episode_return", "episode_seconds", "kl", "reward/upright")
    metrics = pd.DataFrame({name: np.linspace(0, 1, 20) for name in columns})
    learning_curves(metrics, tmp_path / "curves.png")
    assert imageio.imread(tmp_path / "curves.png").std() > 5
