"""Figures of a trigger: how well it foresees falls."""

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

import zfall.evaluation.plots  # noqa: F401 (sets fonts, and that there is no screen)
from zfall.evaluation.plots.colors import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION

RULES = (("s", VERMILION), ("d", GREEN), ("^", PURPLE), ("v", ORANGE))  # by how long they hold


def reliability_plot(
    probability: NDArray[np.float32], truth: NDArray[np.float32], path: Path, *, bins: int = 10
) -> None:
    """Share of steps that end in a fall, over the predicted probability.

    Args:
        probability: predicted at each step ``(K,)``.
        truth: 1 where a fall followed ``(K,)``.
        path: file to write; its ending gives the format.
        bins: of equal width.
    """
    place = np.minimum((probability * bins).astype(int), bins - 1)
    said = [probability[place == b].mean() for b in range(bins) if (place == b).any()]
    seen = [truth[place == b].mean() for b in range(bins) if (place == b).any()]
    figure = Figure(figsize=(3.2, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], "--", color=GREY, lw=1, label="as often as predicted")
    axes.plot(said, seen, "o-", color=BLUE, ms=4, lw=1.4, label="network")
    axes.set_xlabel("predicted probability of a fall", fontsize=8)
    axes.set_ylabel("share that fell", fontsize=8)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize=7, frameon=False)
    figure.savefig(path, dpi=300)


def trigger_plot(rows: pd.DataFrame, path: Path) -> None:
    """Time from trigger to touch over false alarms: the network as a line, rules as marks.

    Args:
        rows: ``trigger`` (network or rule), ``setting``, ``lead_s``, ``false_alarms``.
        path: file to write; its ending gives the format.
    """
    figure = Figure(figsize=(3.5, 3.1), layout="constrained")
    axes = figure.subplots()
    network = rows[rows["trigger"] == "network"].sort_values("false_alarms")
    x, y = 100 * network["false_alarms"], network["lead_s"]
    axes.plot(x, y, "o-", color=BLUE, ms=5, lw=1.4, label="network")
    rules = rows[rows["trigger"] == "rule"]
    hold = rules["setting"].str.extract(r"([\d.]+) s$")[0].astype(float)
    for (value, group), (mark, color) in zip(
        rules.groupby(hold), itertools.cycle(RULES), strict=False
    ):
        x, y = 100 * group["false_alarms"], group["lead_s"]
        axes.plot(x, y, mark, color=color, ms=4.5, mfc="none", label=f"rule, for {value:g} s")
    axes.set_xlabel("false alarms [% of the trials without a fall]", fontsize=8)
    axes.set_ylabel("from trigger to touch, median [s]", fontsize=8)
    axes.set_ylim(bottom=0.0)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize=7, frameon=False)
    figure.savefig(path, dpi=300)
