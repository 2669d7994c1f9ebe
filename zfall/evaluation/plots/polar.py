"""Polar plots: what is withstood, by the direction of the push."""

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Normal, Stroke
from matplotlib.text import Text

from zfall.evaluation.pendulum import CAPTION, Reference
from zfall.evaluation.plots.colors import GREY, LINES, VERMILION
from zfall.evaluation.plots.headings import draw_heading
from zfall.evaluation.statistics import largest_withstood, success_table

SIZE = 8.0, 4.5  # of a figure with one plot and its legend at the right [inch]
RING = 0.75  # darkness of what was not tested


def success_map(
    trials: pd.DataFrame,
    path: Path,
    *,
    title: str,
    baseline: pd.DataFrame | None = None,
    lines: Sequence[Reference] = (),
) -> None:
    """Polar map of the success rate: angle is the push's heading, radius its impulse.

    The robot stands in the middle and looks up. A white line marks I50 in each direction, a dashed
    vermilion one that of the baseline. The grey middle was not tested: it lies below the smallest
    size. Sizes that no trial withstood are left out beyond the first two.

    Args:
        trials: of a planar battery.
        path: file to write; its ending gives the format.
        title: above the plot; lines after the first are smaller.
        baseline: trials of ``pose_hold`` in the same battery.
        lines: drawn besides, with a caption that says what they are.
    """
    table = success_table(trials)
    directions, impulses = table.index.to_numpy(), table.columns.to_numpy()
    step = np.diff(impulses).min() if len(impulses) > 1 else impulses[0]
    edges = np.concatenate([[max(0.0, impulses[0] - step / 2)], impulses + step / 2])
    width = 2 * np.pi / len(directions)
    arc = 12  # straight pieces that make up the arc of a cell
    pieces = width * (np.arange(len(directions) * arc + 1) / arc - 0.5)
    angles = directions[0] + pieces
    figure = Figure(figsize=SIZE, layout="constrained")
    axes: Any = figure.add_subplot(projection="polar")
    axes.set_theta_zero_location("N")
    mesh = axes.pcolormesh(
        angles,
        edges,
        np.repeat(table.to_numpy().T, arc, axis=1),
        cmap="cividis",
        vmin=0,
        vmax=1,
        rasterized=True,
    )
    tables = [table]
    _draw_i50(axes, table, "-", "white", "I50")
    if baseline is not None:
        tables.append(success_table(baseline))
        _draw_i50(axes, tables[1], "--", VERMILION, "I50 of pose_hold")
    withstood = max([0.0, *(float(i) for x in tables for i in x.columns[(x > 0).any()])])
    known = max([0.0, *(float(line.impulse.max()) for line in lines)]) + step
    reach = min(edges[-1], max(withstood + 2.5 * step, known))
    draw_references(axes, lines, "white", rim=True, reach=reach)
    axes.set_ylim(0, reach)
    axes.grid(False)
    name_sides(axes)
    apart = 0.5 if reach > 0.9 else 0.2
    axes.set_yticks([])
    for tick in apart * np.arange(1, np.ceil(reach / apart)):
        axes.plot(angles, np.full_like(angles, tick), color="0.5", lw=0.4)
        name = _name_ring(axes, tick, f"I = {tick:.1f}")
        name.set_color("white")
        name.set_bbox({"facecolor": "0.15", "edgecolor": "none", "pad": 1.2})
    handles, names = axes.get_legend_handles_labels()
    if edges[0] > 0:
        axes.fill_between(angles, 0.0, edges[0], color=str(RING), lw=0)
        handles.append(Line2D([], [], ls="", marker="s", ms=9, color=str(RING)))
        names.append(f"not tested, I < {impulses[0]:g}")
    if withstood + step < impulses[-1]:  # the rest of the map would be empty
        first, last = f"{withstood + step:.1f}", f"{impulses[-1]:.1f}"
        until = f" to {last}" if last != first else ""
        handles.append(Line2D([], [], ls=""))
        names.append(f"none recovered from\nI = {first}{until}, not drawn")
    figure.legend(handles, names, loc="outside right center", fontsize=9, frameon=False)
    bar = figure.colorbar(mesh, ax=axes, location="left", shrink=0.75, pad=0.06)
    bar.set_label("share of trials recovered")
    draw_heading(figure, title)
    _save(figure, path, lines)


def overlay(
    runs: Mapping[str, pd.DataFrame], path: Path, *, title: str, lines: Sequence[Reference] = ()
) -> None:
    """Polar lines of I50 by direction, one for each run, each with its own colour and dashes.

    Args:
        runs: trials of one planar battery by name.
        path: file to write; its ending gives the format.
        title: above the plot; lines after the first are smaller.
        lines: drawn besides, in grey.
    """
    figure = Figure(figsize=(SIZE[0], max(SIZE[1], 0.6 + 0.32 * len(runs))), layout="constrained")
    axes: Any = figure.add_subplot(projection="polar")
    axes.set_theta_zero_location("N")
    for (name, trials), (line, color) in zip(runs.items(), itertools.cycle(LINES), strict=False):
        table = success_table(trials)
        i50 = [largest_withstood(table.columns.to_numpy(), r, 0.5) for r in table.to_numpy()]
        angles = table.index.to_numpy()
        axes.plot(
            np.append(angles, angles[0]),
            np.append(i50, i50[0]),
            line,
            color=color,
            label=f"{textwrap.fill(name, 34)}: {np.mean(i50):.2f}",
        )
    draw_references(axes, lines, GREY)
    axes.set_ylim(0, None)
    name_sides(axes)
    name_rings(axes)
    draw_heading(figure, title)
    given = {"fontsize": 9, "title": "mean I50", "title_fontsize": 9, "frameon": False}
    figure.legend(loc="outside right center", **given)
    _save(figure, path, lines)


def name_sides(axes: Any, **size: float) -> None:
    """Writes the four headings of a push around a polar plot."""
    sides = ["forward", "", "left", "", "backward", "", "right", ""]
    axes.set_thetagrids(range(0, 360, 45), sides, **size)


def name_rings(axes: Any, fontsize: float = 8.0) -> None:
    """Writes the sizes of the rings of a plot without a map, at most five."""
    reach = axes.get_ylim()[1]
    apart = 0.5 if reach > 1.2 else 0.2
    rings = apart * np.arange(1, np.ceil(reach / apart))
    axes.set_yticks(rings, [])
    axes.grid(color="0.85", lw=0.6)
    for ring in rings:
        name = _name_ring(axes, ring, f"{ring:.1f}")
        name.set(color="0.3", fontsize=fontsize)
        name.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.85})


def _name_ring(axes: Any, size: float, name: str) -> Text:
    """Writes the size of a ring at its upper left, over all lines."""
    at = np.deg2rad(22.5), size
    return axes.text(*at, name, ha="center", va="center", fontsize=8, weight="bold", zorder=10)


def draw_references(
    axes: Any,
    lines: Sequence[Reference],
    color: str,
    *,
    rim: bool = False,
    reach: float = np.inf,
) -> None:
    """Adds thin lines, and crosses where a reference has but a few directions.

    Those that lie wholly beyond ``reach`` are not named.
    """
    rims = {"path_effects": [Stroke(linewidth=2.4, foreground="black"), Normal()]} if rim else {}
    styles = itertools.cycle(["-.", "--", (0, (1, 2)), "-"])
    for line, style in zip(lines, styles, strict=False):
        name = line.name if line.impulse.min() < reach else None
        if len(line.angle) < 12:
            axes.plot(line.angle, line.impulse, "x", color=color, ms=6, label=name, **rims)
        else:
            axes.plot(line.angle, line.impulse, color=color, lw=1, ls=style, label=name, **rims)


def _save(figure: Figure, path: Path, lines: Sequence[Reference]) -> None:
    """Writes a figure; a caption on its reference lines, if any, lies below it."""
    if lines:
        figure.supxlabel(textwrap.fill(CAPTION, 105), fontsize=8, color="0.3")
    figure.savefig(path, dpi=200)


def _draw_i50(axes: Any, table: pd.DataFrame, style: str, color: str, label: str) -> None:
    """Adds a line with a dark rim, to be seen on either end of the color map."""
    impulses = table.columns.to_numpy()
    i50 = np.array([largest_withstood(impulses, rates, 0.5) for rates in table.to_numpy()])
    angles = table.index.to_numpy()
    axes.plot(
        np.append(angles, angles[0]),
        np.append(i50, i50[0]),
        style,
        color=color,
        lw=1.8,
        label=label,
        path_effects=[Stroke(linewidth=3.6, foreground="black"), Normal()],
    )
