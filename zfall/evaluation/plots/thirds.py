"""Success by thirds of what was drawn."""

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure

from zfall.evaluation.plots.colors import BLUE, GREY, VERMILION
from zfall.evaluation.plots.headings import draw_heading

PARTS = {"low": ("v", BLUE), "middle": ("o", GREY), "high": ("^", VERMILION)}
CHANCE, ROOM = 0.05, 5.0  # a p; on either side of all marks [%]
UNITS = {
    "backlash": "rad",
    "com_offset": "m",
    "command_latency": "s",
    "encoder_latency": "s",
    "imu_latency": "s",
    "imu_misalignment": "rad",
    "joint_zero_offset": "rad",
    "payload": "kg",
    "slope": "rad",
    "supply_resistance": "Ohm",
}  # the others are factors


def thirds_plot(table: pd.DataFrame, path: Path, *, title: str) -> None:
    """A row for each drawn parameter: success in the thirds with its low, middle, high values.

    Rows that chance explains as well, with a p above ``CHANCE``, are faint. Names stand without
    their underscores, ranges with their unit.

    Args:
        table: of ``success_by_draw``; the first row comes to the top.
        path: file to write; its ending gives the format.
        title: above the plot.
    """
    figure = Figure(figsize=(6.4, 1.2 + 0.24 * len(table)), layout="constrained")
    axes, places = figure.subplots(), range(len(table))
    shares = 100 * table[[*PARTS]]
    clear = np.where(table["p"] <= CHANCE, 1.0, 0.3)
    grey = to_rgba_array("0.7", clear)
    axes.hlines(places, shares.min(axis=1), shares.max(axis=1), colors=list(grey), lw=1.5)
    for part, (marker, color) in PARTS.items():
        colors = to_rgba_array(color, clear)
        axes.scatter(shares[part], places, s=25, c=colors, marker=marker)
        axes.plot([], [], marker, color=color, ms=5, label=f"{part} third")
    axes.set_yticks(places, [_name(row) for row in table.to_dict("records")], fontsize=8)
    axes.invert_yaxis()
    axes.tick_params(labelsize=8)
    axes.set_xlabel("recovered [%]", fontsize=8)
    low, high = np.nanmin(shares), np.nanmax(shares)
    axes.set_xlim(max(-1.0, low - ROOM), min(101.0, high + ROOM))
    axes.grid(alpha=0.3, axis="x")
    draw_heading(figure, title)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    figure.savefig(path, dpi=200)


def _name(row: Mapping[Hashable, Any]) -> str:
    """A parameter, the values that were drawn, and p."""
    parameter = str(row["parameter"])
    unit = UNITS.get(parameter, "")
    drawn = f"{row['smallest']:.3g} to {row['largest']:.3g} {unit}".rstrip()
    return f"{parameter.replace('_', ' ')}, {drawn}    p = {row['p']:.1g}"
