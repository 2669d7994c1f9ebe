"""Success by thirds of what was drawn."""

import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure

from zfall.evaluation.plots.polar import BLUE, GREY, VERMILION

PARTS = {"low": ("v", BLUE), "middle": ("o", GREY), "high": ("^", VERMILION)}
CHANCE = 0.05


def thirds_plot(table: pd.DataFrame, path: Path, *, title: str) -> None:
    """A row for each drawn parameter: success in the thirds with its low, middle, high values.

    Rows that chance explains as well, with a p above ``CHANCE``, are faint.

    Args:
        table: of ``success_by_draw``; the first row comes to the top.
        path: file to write; its ending gives the format.
        title: above the plot.
    """
    figure = Figure(figsize=(5.2, 1.2 + 0.24 * len(table)), layout="constrained")
    axes, places = figure.subplots(), range(len(table))
    shares = 100 * table[[*PARTS]]
    clear = np.where(table["p"] <= CHANCE, 1.0, 0.3)
    grey = to_rgba_array("0.7", clear)
    axes.hlines(places, shares.min(axis=1), shares.max(axis=1), colors=list(grey), lw=1.5)
    for part, (marker, color) in PARTS.items():
        colors = to_rgba_array(color, clear)
        axes.scatter(shares[part], places, s=25, c=colors, marker=marker)
        axes.plot([], [], marker, color=color, ms=5, label=f"{part} third")
    names = [
        f"{row.parameter}  {row.smallest:.3g} to {row.largest:.3g}   p {row.p:.1g}"
        for row in table.itertuples(index=False)
    ]
    axes.set_yticks(places, names, fontsize=8)
    axes.invert_yaxis()
    axes.tick_params(labelsize=8)
    axes.set_xlabel("recovered [%]", fontsize=8)
    axes.set_xlim(left=0.0)
    axes.grid(alpha=0.3, axis="x")
    figure.suptitle(textwrap.fill(title, 66, break_on_hyphens=False), fontsize=9)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    figure.savefig(path, dpi=150)
