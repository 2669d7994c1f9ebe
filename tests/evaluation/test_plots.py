"""Plots are written and not empty."""

import imageio.v2 as imageio
import numpy as np
import pandas as pd
import pytest

from zfall.envs.robots import ZEROTH01
from zfall.evaluation.pendulum import references
from zfall.evaluation.plots import (
    learning_bands,
    learning_curves,
    profiles_plot,
    success_map,
    trace_plot,
    withstood_map,
)
from zfall.evaluation.plots.curves import _binned


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


@pytest.mark.parametrize("ending", ["png", "pdf"])
def test_every_figure_is_drawn(tmp_path, ending):
    generator = np.random.default_rng(0)
    columns = ("frames", "episode_seconds")
    seeds = [pd.DataFrame({c: np.arange(1, 60) + generator.random() for c in columns})] * 2
    rows = pd.DataFrame(
        [
            {"direction_rad": d, "impulse": i, "recovered": i < 0.3, "body": "pelvis",
             "duration_s": 0.1 * (1 + (d > 3)), "withstood": 3.0 * i, "fell": False}
            for d in np.arange(0, 2 * np.pi, np.pi / 6)
            for i in (0.0, 0.1, 0.2, 0.3, 0.4)
        ]
    )  # fmt: skip
    trace = pd.DataFrame(
        {c: np.sin(np.arange(50)) for c in ("time_s", "target", "position", "torque")}
    )
    lines = references(ZEROTH01, 0.1)
    figures = {
        "bands": lambda p: learning_bands({"a": seeds, "b": seeds[:1]}, p),
        "heat": lambda p: withstood_map(rows, p, title="test"),
        "profiles": lambda p: profiles_plot({"a": rows}, p, title="test"),
        "traces": lambda p: trace_plot({"a": trace}, p, joint="knee", push=(3.0, 3.1)),
        "map": lambda p: success_map(rows, p, title="test", lines=lines),
    }
    for name, draw in figures.items():
        path = tmp_path / f"{name}.{ending}"
        draw(path)
        assert path.stat().st_size > 4000
        if ending == "png":
            assert imageio.imread(path).std() > 5


def test_curves_are_averaged_over_what_falls_into_a_bin():
    run = pd.DataFrame({"frames": [1.0, 2.0, 3.0, 9.0], "value": [1.0, 3.0, 5.0, 7.0]})
    assert _binned(run, "value", np.array([0.0, 2.0, 4.0, 6.0, 10.0])).tolist() == [
        2.0,
        5.0,
        6.0,
        7.0,
    ]
