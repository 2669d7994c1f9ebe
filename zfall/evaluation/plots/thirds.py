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
from zfall.evaluation.statistics import wilson

PARTS = {"low": ("v", BLUE), "middle": ("o", GREY), "high": ("^", VERMILION)}
CHANCE = 0.05  # a p; above it chance explains a difference as well
MOST = 5  # rows
APART = 0.2  # of the marks in a row
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

    The five that explain most; how many others there are, and whether any of them does more than
    chance, is said below. Bars are Wilson's 95 % intervals. Rows that chance explains as well, with
    a p above ``CHANCE``, are faint. Names stand without their underscores, ranges with their unit.

    Args:
        table: of ``success_by_draw``; the first row comes to the top.
        path: file to write; its ending gives the format.
        title: above the plot; lines after the first are smaller.
    """
    shown, others = table.head(MOST), table.iloc[MOST:]
    figure = Figure(figsize=(7.5, 1.6 + 0.5 * len(shown)), layout="constrained")
    axes, places = figure.subplots(), np.arange(len(shown))
    clear = np.where(shown["p"] <= CHANCE, 1.0, 0.3)
    for number, (part, (marker, color)) in enumerate(PARTS.items()):
        colors = to_rgba_array(color, clear)
        across, shares = places + (number - 1) * APART, 100 * shown[part]
        bars = [
            100 * np.array(_wilson(*row))
            for row in zip(shown[part], shown[f"n_{part}"], strict=True)
        ]
        low, high = np.array(bars).T
        axes.hlines(across, low, high, colors=list(colors), lw=1.5)
        axes.scatter(shares, across, s=28, c=colors, marker=marker)
        axes.plot([], [], marker, color=color, ms=5, label=f"{part} third")
    axes.set_yticks(places, [_name(row) for row in shown.to_dict("records")], fontsize=9)
    axes.invert_yaxis()
    axes.tick_params(labelsize=9)
    below = "recovered [%], with 95 % intervals"
    if len(others):
        effect = "no effect" if others["p"].min() > CHANCE else "smaller effects or none"
        below += f"\n{len(others)} others: {effect}"
    axes.set_xlabel(below, fontsize=9)
    axes.grid(alpha=0.3, axis="x")
    draw_heading(figure, title)
    figure.legend(loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    figure.savefig(path, dpi=200)


def _wilson(share: float, trials: int) -> tuple[float, float]:
    """Interval of a share; NaN of an empty third."""
    return wilson(round(share * trials), trials) if trials else (np.nan, np.nan)


def _name(row: Mapping[Hashable, Any]) -> str:
    """A parameter, and the values that were drawn."""
    parameter = str(row["parameter"])
    unit = UNITS.get(parameter, "")
    drawn = f"{row['smallest']:.3g} to {row['largest']:.3g} {unit}".rstrip()
    return f"{parameter.replace('_', ' ')},\n{drawn}"
