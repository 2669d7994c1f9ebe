"""Figures of a trigger: how well it foresees falls."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

import zfall.evaluation.plots  # noqa: F401 (sets fonts, and that there is no screen)


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
    figure = Figure(figsize=(3.2, 3.0), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], ":", color="0.5", lw=1)
    axes.plot(said, seen, "o-", color="0.0", ms=4, lw=1)
    axes.set_xlabel("predicted probability of a fall", fontsize=8)
    axes.set_ylabel("share that fell", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=300)


def trigger_plot(rows: pd.DataFrame, path: Path) -> None:
    """Time from trigger to touch over false alarms: the network as a line, rules as marks.

    Args:
        rows: ``trigger`` (network or rule), ``setting``, ``lead_s``, ``false_alarms``.
        path: file to write; its ending gives the format.
    """
    figure = Figure(figsize=(3.5, 2.8), layout="constrained")
    axes = figure.subplots()
    network = rows[rows["trigger"] == "network"].sort_values("false_alarms")
    axes.plot(
        100 * network["false_alarms"], network["lead_s"], "o-", color="0.0", ms=4, label="network"
    )
    rules = rows[rows["trigger"] == "rule"]
    hold = rules["setting"].str.extract(r"([\d.]+) s$")[0].astype(float)
    for (value, group), mark in zip(rules.groupby(hold), "sd^x+", strict=False):
        label = f"rule, for {value:g} s"
        x, y = 100 * group["false_alarms"], group["lead_s"]
        axes.plot(x, y, mark, color="0.5", ms=4, mfc="none", label=label)
    axes.set_xlabel("false alarms [%]", fontsize=8)
    axes.set_ylabel("from trigger to touch, median [s]", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)
    figure.savefig(path, dpi=300)
