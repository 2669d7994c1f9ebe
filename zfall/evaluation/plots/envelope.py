"""Polar plots of the largest push, one for each push point."""

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from zfall.evaluation.pendulum import CAPTION, Reference
from zfall.evaluation.plots.colors import GREY, LINES
from zfall.evaluation.plots.headings import draw_heading
from zfall.evaluation.plots.polar import draw_references, name_rings, name_sides


def envelope_plot(
    tables: Mapping[str, pd.DataFrame], path: Path, *, title: str, lines: Sequence[Reference] = ()
) -> None:
    """Largest impulse recovered from by direction, a polar plot for each push point, in a row.

    Args:
        tables: of ``envelope_table`` by name of the policy, each with its own colour and dashes.
        path: file to write; its ending gives the format.
        title: above the plots; lines after the first are smaller.
        lines: drawn besides, in grey, those with a push point in its plot alone; named below.
    """
    bodies = list(dict.fromkeys(next(iter(tables.values()))["body"]))
    wide = max(6.0, 2.6 * len(bodies))
    figure = Figure(
        figsize=(wide, 3.1 + 0.18 * len(tables) + 0.7 * bool(lines)), layout="constrained"
    )
    drawn = {line.name: line for line in lines if line.point in (None, *bodies)}
    most = (float(table["largest"].max()) for table in tables.values())
    reach = 1.05 * max([0.1, *most, *(float(line.impulse.max()) for line in drawn.values())])
    named: dict[str, Any] = {}
    for place, body in enumerate(bodies, 1):
        axes: Any = figure.add_subplot(1, len(bodies), place, projection="polar")
        axes.set_theta_zero_location("N")
        pairs = zip(tables.items(), itertools.cycle(LINES), strict=False)
        for (name, table), (line, color) in pairs:
            cells = table[table["body"] == body].sort_values("direction_rad")
            angles, largest = cells["direction_rad"].to_numpy(), cells["largest"].to_numpy()
            around = np.append(angles, angles[0]), np.append(largest, largest[0])
            axes.plot(*around, line, color=color, label=f"{name}: mean {largest.mean():.2f}")
        handles, _ = axes.get_legend_handles_labels()
        draw_references(axes, [x for x in drawn.values() if x.point in (None, body)], GREY)
        also, names = axes.get_legend_handles_labels()
        named |= dict(zip(names[len(handles) :], also[len(handles) :], strict=True))
        axes.set_ylim(0, reach)
        name_sides(axes, fontsize=9.5)
        name_rings(axes, 9.5)
        axes.set_title(f"pushed at the {str(body).replace('_', ' ')}", fontsize=10.5)
        under = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.08), "frameon": False}
        axes.legend(handles=handles, fontsize=9.5, **under)
    if named:
        ordered = [name for name in drawn if name in named]
        figure.legend(
            [named[name] for name in ordered],
            ordered,
            loc="outside lower center",
            ncols=4,
            fontsize=9.5,
            frameon=False,
            title=textwrap.fill(CAPTION, 120),
            title_fontsize=9.5,
        )
    draw_heading(figure, title)
    figure.savefig(path, dpi=200)
