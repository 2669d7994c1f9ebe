"""Polar plots: what is withstood, by the direction of the push."""

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.text import Text

from zfall.evaluation.pendulum import CAPTION, Reference
from zfall.evaluation.plots.colors import GREY, LINES, VERMILION
from zfall.evaluation.statistics import largest_withstood, success_table

TITLE = 44  # characters in a line of a title


def success_map(
    trials: pd.DataFrame,
    path: Path,
    *,
    title: str,
    baseline: pd.DataFrame | None = None,
    lines: Sequence[Reference] = (),
) -> None:
    """Polar map of the success rate: angle is the push's heading, radius its impulse.

    The robot stands in the middle and looks up. A line marks I50 in each direction, a dotted
    one that of the baseline. Sizes that no trial withstood are left out beyond the first two.

    Args:
        trials: of a planar battery.
        path: file to write; its ending gives the format.
        title: above the plot.
        baseline: trials of ``pose_hold`` in the same battery.
        lines: drawn besides, with a caption that says what they are.
    """
    table = success_table(trials)
    directions, impulses = table.index.to_numpy(), table.columns.to_numpy()
    step = np.diff(impulses).min() if len(impulses) > 1 else impulses[0]
    edges = np.concatenate([[impulses[0] - step / 2], impulses + step / 2])
    width = 2 * np.pi / len(directions)
    arc = 12  # straight pieces that make up the arc of a cell
    pieces = width * (np.arange(len(directions) * arc + 1) / arc - 0.5)
    angles = directions[0] + pieces
    figure = Figure(figsize=(5.0, 5.4), layout="constrained")
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
    title = textwrap.fill(title, TITLE, break_on_hyphens=False)
    reach = min(edges[-1], max(withstood + 2.5 * step, known))
    _draw_references(axes, lines, "white", rim=True, reach=reach)
    axes.set_ylim(0, reach)
    if withstood + step < impulses[-1]:  # the rest of the map would be empty
        first, last = f"{withstood + step:.1f}", f"{impulses[-1]:.1f}"
        title += f"\nnone recovered from I = {first}" + (f" to {last}" if last != first else "")
    axes.grid(False)
    _name_sides(axes)
    apart = 0.5 if reach > 0.9 else 0.2
    axes.set_yticks([])
    for tick in apart * np.arange(1, np.ceil(reach / apart)):
        axes.plot(angles, np.full_like(angles, tick), color="0.5", lw=0.4)
        name = _name_ring(axes, tick, f"I = {tick:.1f}")
        name.set(color="white", zorder=10)
        name.set_path_effects([Stroke(linewidth=2, foreground="black"), Normal()])
    axes.set_title(title, fontsize=10, pad=12)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, fontsize=8, frameon=False)
    bar = figure.colorbar(mesh, ax=axes, shrink=0.6, pad=0.12)
    bar.set_label("share of trials recovered")
    _save(figure, path, lines)


def _name_sides(axes: Any, **size: float) -> None:
    """Writes the four headings of a push around a polar plot."""
    sides = ["forward", "", "left", "", "backward", "", "right", ""]
    axes.set_thetagrids(range(0, 360, 45), sides, **size)


def _name_rings(axes: Any) -> None:
    """Writes the sizes of the rings of a plot without a map, at most five."""
    reach = axes.get_ylim()[1]
    apart = 0.5 if reach > 1.2 else 0.2
    rings = apart * np.arange(1, np.ceil(reach / apart))
    axes.set_yticks(rings, [])
    axes.grid(color="0.85", lw=0.6)
    for ring in rings:
        _name_ring(axes, ring, f"{ring:.1f}").set_color("0.4")


def _name_ring(axes: Any, size: float, name: str) -> Text:
    """Writes the size of a ring at its upper left, behind all lines."""
    at = np.deg2rad(22.5), size
    return axes.text(*at, name, ha="center", va="center", fontsize=7, weight="bold", zorder=1.4)


def _draw_references(
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


def _save(
    figure: Figure, path: Path, lines: Sequence[Reference] = (), *, below: float = 4.0
) -> None:
    """Writes a figure; a caption on its reference lines, if any, lies below it [points]."""
    if lines:
        caption = "\n".join(textwrap.wrap(CAPTION, 82))
        place = 0.5, -below / 72 / figure.get_figheight()
        figure.text(*place, caption, ha="center", va="top", fontsize=7, color="0.3")
    figure.savefig(path, dpi=200, bbox_inches="tight", pad_inches=0.08)


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


def overlay(
    runs: Mapping[str, pd.DataFrame], path: Path, *, title: str, lines: Sequence[Reference] = ()
) -> None:
    """Polar lines of I50 by direction, one for each run, each with its own colour and dashes.

    Args:
        runs: trials of one planar battery by name.
        path: file to write; its ending gives the format.
        title: above the plot.
        lines: drawn besides, in grey.
    """
    figure = Figure(figsize=(4.6, 5.2), layout="constrained")
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
            label=f"{name}: {np.mean(i50):.2f}",
        )
    _draw_references(axes, lines, GREY)
    axes.set_ylim(0, None)
    _name_sides(axes)
    _name_rings(axes)
    axes.set_title(textwrap.fill(title, TITLE, break_on_hyphens=False), fontsize=10, pad=12)
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.08),
        ncols=2,
        fontsize=8,
        title="mean I50",
        frameon=False,
    )
    _save(figure, path, lines)


def envelope_plot(
    tables: Mapping[str, pd.DataFrame], path: Path, *, title: str, lines: Sequence[Reference] = ()
) -> None:
    """Largest impulse recovered from by direction, a polar plot for each push point.

    Args:
        tables: of ``envelope_table`` by name of the policy, each with its own colour and dashes.
        path: file to write; its ending gives the format.
        title: above the plots.
        lines: drawn besides, in grey; named below all plots.
    """
    bodies = list(dict.fromkeys(next(iter(tables.values()))["body"]))
    columns, rows = min(len(bodies), 2), -(-len(bodies) // 2)
    figure = Figure(figsize=(3.4 * columns, 3.5 * rows), layout="constrained")
    most = (float(table["largest"].max()) for table in tables.values())
    reach = 1.05 * max([0.1, *most, *(float(line.impulse.max()) for line in lines)])
    for place, body in enumerate(bodies, 1):
        axes: Any = figure.add_subplot(rows, columns, place, projection="polar")
        axes.set_theta_zero_location("N")
        pairs = zip(tables.items(), itertools.cycle(LINES), strict=False)
        for (name, table), (line, color) in pairs:
            cells = table[table["body"] == body].sort_values("direction_rad")
            angles, largest = cells["direction_rad"].to_numpy(), cells["largest"].to_numpy()
            around = np.append(angles, angles[0]), np.append(largest, largest[0])
            axes.plot(*around, line, color=color, label=f"{name}: mean {largest.mean():.2f}")
        handles, _ = axes.get_legend_handles_labels()
        _draw_references(axes, lines, GREY)
        axes.set_ylim(0, reach)
        _name_sides(axes, fontsize=8)
        _name_rings(axes)
        axes.set_title(body, fontsize=10)
        axes.legend(
            handles=handles,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.1),
            ncols=2,
            fontsize=8,
            frameon=False,
        )
    drawn, names = figure.axes[0].get_legend_handles_labels()
    if references := drawn[len(handles) :]:
        figure.legend(
            references,
            names[len(handles) :],
            loc="upper center",
            bbox_to_anchor=(0.5, 0.0),
            ncols=4,
            fontsize=8,
            frameon=False,
        )
    figure.suptitle(textwrap.fill(title, TITLE, break_on_hyphens=False), fontsize=11)
    _save(figure, path, lines, below=24)
