"""Plots are written and not empty."""

from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.text import Text

from zfall.evaluation.pendulum import Reference, references
from zfall.evaluation.plots import (
    envelope_plot,
    learning_bands,
    learning_curves,
    overlay,
    profiles_plot,
    success_map,
    trace_plot,
    withstood_map,
)
from zfall.evaluation.plots.curves import _binned
from zfall.robots import ZEROTH01


def test_success_map_shows_each_share_where_it_belongs(tmp_path, monkeypatch):
    """Half of the pushes forward fail at I = 0.2; the cell is where its heading and size are."""
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *args, **kwargs: drawn.append(figure))
    rows = [
        {"direction_rad": d, "impulse": i, "recovered": (d, i, k) != (0.0, 0.2, 1) and i < 0.3}
        for d in np.arange(0, 2 * np.pi, np.pi / 2)
        for i in (0.0, 0.1, 0.2, 0.3)
        for k in (0, 1)
    ]
    success_map(pd.DataFrame(rows), tmp_path / "map.png", title="test")
    (mesh,) = [c for c in drawn[0].axes[0].collections if isinstance(c, QuadMesh)]
    corners = mesh.get_coordinates()  # heading [rad] and size of the corners of the cells
    middle = corners[:-1, :-1] + 0.5 * (corners[1:, 1:] - corners[:-1, :-1])
    share = np.asarray(mesh.get_array()).reshape(middle.shape[:2])
    for (heading, size), value in zip(middle.reshape(-1, 2), share.ravel(), strict=True):
        forward = abs(heading) < np.pi / 4
        expected = 0.0 if size > 0.25 else 0.5 if forward and size > 0.15 else 1.0
        assert value == expected, (heading, size)


def test_success_map_is_drawn_beside_a_baseline(tmp_path, monkeypatch):
    """The baseline withstands 0.1 more; each has its line at its I50 in all directions."""
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *args, **kwargs: drawn.append(figure))
    rows = [
        {"direction_rad": d, "impulse": i, "recovered": i < 0.3}
        for d in np.arange(0, 2 * np.pi, np.pi / 6)
        for i in (0.0, 0.1, 0.2, 0.3, 0.4)
    ]
    better = pd.DataFrame(rows)
    better["recovered"] = better["impulse"] < 0.4
    success_map(pd.DataFrame(rows), tmp_path / "map.png", title="test", baseline=better)
    lines = {line.get_label(): line for line in drawn[0].axes[0].lines}
    assert np.asarray(lines["I50"].get_ydata()) == pytest.approx(0.2)
    assert np.asarray(lines["I50 of pose_hold"].get_ydata()) == pytest.approx(0.3)


def test_a_reference_beyond_the_map_is_not_named(tmp_path, monkeypatch):
    """Sizes up to 0.4 end at 0.45: one line crosses that, another does not come near."""
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *args, **kwargs: drawn.append(figure))
    trials = pd.DataFrame(
        [{"direction_rad": d, "impulse": i, "recovered": i < 0.3} for d in (0.0, 1.0) for i in (0.0, 0.1, 0.2, 0.3, 0.4)]
    )  # fmt: skip
    angle = np.linspace(0, 2 * np.pi, 20)
    lines = [Reference("in", angle, np.linspace(0.4, 2, 20)), Reference("out", angle, angle + 0.5)]
    success_map(trials, tmp_path / "map.png", title="test", lines=lines)
    names = [text.get_text() for text in drawn[0].legends[0].get_texts()]
    assert names == [
        "I50",
        "in",
        "not tested, I < 0.1",
        "none recovered from\nI = 0.3 to 0.4, not drawn",
    ]


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
        "traces": lambda p: trace_plot({"a": trace}, p, joint="knee", pushes=[(3.0, 3.1)]),
        "map": lambda p: success_map(rows, p, title="test", lines=lines),
    }
    for name, draw in figures.items():
        path = tmp_path / f"{name}.{ending}"
        draw(path)
        assert path.stat().st_size > 4000
        if ending == "png":
            assert imageio.imread(path).std() > 5


def test_sixteen_lines_of_a_plot_all_differ_also_without_colour(tmp_path, monkeypatch):
    """By dashes and marks; of curves, profiles, traces and polar plots."""
    drawn: list[Figure] = []

    def drawn_to(figure: Figure, path: Path, **kwargs: object) -> None:
        drawn.append(figure)
        path.touch()

    monkeypatch.setattr(Figure, "savefig", drawn_to)
    names = "abcdefghijklmnop"
    steps = np.linspace(0.0, 1.0, 20)
    curve = pd.DataFrame({"frames": steps + 1.0, "episode_seconds": steps})
    trace = pd.DataFrame(dict.fromkeys(("time_s", "target", "position", "torque"), steps))
    trials = pd.DataFrame(
        [{"direction_rad": d, "impulse": i, "recovered": i < 0.3} for d in (0.0, 1.0) for i in (0.0, 0.1, 0.4)]
    )  # fmt: skip
    learning_bands({name: [curve] for name in names}, tmp_path / "a.png")
    profiles_plot(dict.fromkeys(names, trials), tmp_path / "b.png", title="test")
    trace_plot(dict.fromkeys(names, trace), tmp_path / "c.png", joint="knee", pushes=[(0.5, 0.6)])
    overlay(dict.fromkeys(names, trials), tmp_path / "d.png", title="test")
    envelope = pd.DataFrame({"body": "torso", "direction_rad": steps, "largest": steps})
    envelope_plot(dict.fromkeys(names, envelope), tmp_path / "e.png", title="test")
    metrics = pd.DataFrame(
        dict.fromkeys(("frames", "episode_return", "episode_seconds", "kl"), steps)
    )
    learning_curves(dict.fromkeys(names, metrics), tmp_path / "f.png")
    assert len(drawn) == 6
    for figure in drawn:
        lines = [line for line in figure.axes[0].lines if line.get_label()[0] in names]
        assert len(lines) == 16
        assert len({(line.get_linestyle(), line.get_marker()) for line in lines}) == 16


def test_an_envelope_shows_other_robots_only_where_these_were_pushed(tmp_path, monkeypatch):
    """Panels in one row; the pendulum in all, iCub and Atalante in that of the pelvis."""
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *args, **kwargs: drawn.append(figure))
    rows = [
        {"body": body, "direction_rad": d, "largest": size}
        for body, size in (("torso", 0.5), ("pelvis", 0.25))
        for d in np.arange(0, 2 * np.pi, np.pi / 6)
    ]
    lines = references(ZEROTH01, 0.1)
    envelope_plot({"mine": pd.DataFrame(rows)}, tmp_path / "a.png", title="test", lines=lines)
    (figure,) = drawn
    named = [[t.get_text() for t in axes.get_legend().get_texts()] for axes in figure.axes]
    assert named == [["mine: mean 0.50"], ["mine: mean 0.25"]]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [line.name for line in lines]
    shown = [{str(line.get_label()) for line in axes.lines} for axes in figure.axes]
    assert shown[1] - shown[0] == {"mine: mean 0.25", "iCub", "Atalante"}
    figure.draw_without_rendering()
    left, right = (axes.get_position() for axes in figure.axes)
    assert left.x1 < right.x0
    assert left.y0 == pytest.approx(right.y0)


def test_polar_plots_fit_a_slide_with_type_of_at_least_12_points(tmp_path, monkeypatch):
    """Scaled into 13.3 x 7.5 inch; nothing lies over anything else, and the plot is landscape."""
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *args, **kwargs: drawn.append(figure))
    trials = pd.DataFrame(
        [{"direction_rad": d, "impulse": i, "recovered": i < 0.3} for d in (0.0, 1.0) for i in (0.1, 0.2, 0.3, 0.9)]
    )  # fmt: skip
    lines = references(ZEROTH01, 0.1)
    title = "mine: battery planar\n" + "words of the second line " * 6
    success_map(trials, tmp_path / "a.png", title=title, baseline=trials, lines=lines)
    overlay({"mine": trials, "other": trials}, tmp_path / "b.png", title=title, lines=lines)
    profiles_plot({"mine": trials, "other": trials}, tmp_path / "c.png", title=title)
    for figure in drawn:
        figure.draw_without_rendering()
        wide, high = figure.get_size_inches()
        assert wide > high
        scale = min(13.3 / wide, 7.5 / high)
        texts = [text for text in figure.findobj(Text) if text.get_text().strip()]
        assert min(text.get_fontsize() for text in texts) * scale > 12
        (legend,) = figure.legends
        box = legend.get_window_extent()
        assert not any(box.overlaps(axes.get_tightbbox()) for axes in figure.axes)
        assert box.x1 <= figure.bbox.x1 + 1


def test_the_same_curves_give_the_same_pdf(tmp_path, monkeypatch):
    """A study shown again changes no file, whenever that is."""
    curve = pd.DataFrame({"frames": [1.0, 2.0, 3.0], "episode_seconds": [1.0, 2.0, 3.0]})
    for name, time in (("a", "0"), ("b", "1000000")):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", time)  # what matplotlib takes for today
        learning_bands({"run": [curve, curve]}, tmp_path / f"{name}.pdf")
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()


def test_curves_are_averaged_over_what_falls_into_a_bin():
    run = pd.DataFrame({"frames": [1.0, 2.0, 3.0, 9.0], "value": [1.0, 3.0, 5.0, 7.0]})
    assert _binned(run, "value", np.array([0.0, 2.0, 4.0, 6.0, 10.0])).tolist() == [
        2.0,
        5.0,
        6.0,
        7.0,
    ]


def test_the_legend_of_a_trace_covers_nothing(tmp_path, monkeypatch):
    """Run folders are named by date and time: longer than the title leaves room for."""
    drawn = []
    save = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda self, *a, **k: drawn.append(self) or save(self, *a, **k)
    )
    columns = ("time_s", "target", "position", "torque")
    rows = pd.DataFrame([[0.0] * 4, [1.0] * 4], columns=columns)
    names = ("runs/quickstart/2026-01-02_03-04-05-060708", "pose_hold")
    path = tmp_path / "trace.png"
    trace_plot(dict.fromkeys(names, rows), path, joint="left_hip_pitch", pushes=[(0.5, 0.6)])
    (legend,) = drawn[0].legends
    box = legend.get_window_extent()
    assert [text.get_text() for text in legend.get_texts()] == list(names)
    assert not any(box.overlaps(axes.get_tightbbox()) for axes in drawn[0].axes)
    assert box.x0 >= 0
    assert box.x1 <= drawn[0].bbox.x1
