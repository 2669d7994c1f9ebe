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


def reliability_table(
    probability: NDArray[np.float32], truth: NDArray[np.float32], *, bins: int = 10
) -> pd.DataFrame:
    """Rows by predicted probability: its mean ``predicted``, the share that ``fell``, ``steps``.

    Args:
        probability: predicted at each step ``(K,)``.
        truth: 1 where a fall followed ``(K,)``.
        bins: of equal width; those without a step have no row.
    """
    place = np.minimum((probability * bins).astype(int), bins - 1)
    rows = pd.DataFrame({"predicted": probability, "fell": truth}).astype(float).groupby(place)
    return rows.mean().assign(steps=rows.size()).reset_index(drop=True)


def reliability_plot(table: pd.DataFrame, path: Path) -> None:
    """Share of steps that end in a fall, over the predicted probability, with their numbers.

    Args:
        table: of ``reliability_table``.
        path: file to write; its ending gives the format.
    """
    figure = Figure(figsize=(5.0, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], "--", color=GREY, lw=1, label="falls as often as predicted")
    axes.plot(table["predicted"], table["fell"], "o-", color=BLUE, ms=4, lw=1.4, label="network")
    for x, y, steps in zip(table["predicted"], table["fell"], table["steps"], strict=True):
        left = x > 0.5  # on the free side of the diagonal
        axes.annotate(
            f"{steps}",
            (x, y),
            xytext=(-7, 4) if left else (7, -4),
            textcoords="offset points",
            ha="right" if left else "left",
            va="bottom" if left else "top",
            fontsize=8,
            color="0.3",
        )
    axes.set_xlabel("predicted probability of a fall; numbers are control steps", fontsize=9)
    axes.set_ylabel("share that fell", fontsize=9)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=9)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    figure.savefig(path, dpi=200)


def trigger_plot(rows: pd.DataFrame, path: Path) -> None:
    """Time from trigger to touch over false alarms: the network as a line, rules as marks.

    False alarms are on a logarithmic scale, linear below 0.1 %. Points of the network bear their
    thresholds; the legend says the share of the falls that were detected.

    Args:
        rows: ``trigger`` (network or rule), ``setting``, ``detected``, ``lead_s``,
            ``false_alarms``.
        path: file to write; its ending gives the format.
    """
    figure = Figure(figsize=(7.5, 4.2), layout="constrained")
    axes = figure.subplots()
    network = rows[rows["trigger"] == "network"].sort_values("false_alarms")
    x, y = 100 * network["false_alarms"], network["lead_s"]
    label = f"network, {_detected(network)}"
    axes.plot(x, y, "o-", color=BLUE, ms=5, lw=1.4, label=label)
    for at, height, setting in zip(x, y, network["setting"], strict=True):
        axes.annotate(
            f"p > {setting}",
            (at, height),
            xytext=(0, 7),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=BLUE,
        )
    rules = rows[rows["trigger"] == "rule"]
    hold = rules["setting"].str.extract(r"([\d.]+) s$")[0].astype(float)
    for (value, group), (mark, color) in zip(
        rules.groupby(hold), itertools.cycle(RULES), strict=False
    ):
        x, y = 100 * group["false_alarms"], group["lead_s"]
        label = f"rule, for {value:g} s, {_detected(group)}"
        axes.plot(x, y, mark, color=color, ms=5, mfc="none", label=label)
    axes.set_xscale("symlog", linthresh=0.1)
    axes.set_xlim(left=0.0)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlabel("false alarms [% of the trials without a fall]", fontsize=9)
    axes.set_ylabel("from trigger to touch, median [s]", fontsize=9)
    axes.set_ylim(0.0, 1.12 * float(rows["lead_s"].max()))
    axes.tick_params(labelsize=9)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    figure.savefig(path, dpi=200)


def _detected(rows: pd.DataFrame) -> str:
    """The share of the falls that were detected, or its range over settings."""
    least, most = 100 * rows["detected"].min(), 100 * rows["detected"].max()
    spread = f"{least:.0f} to {most:.0f}" if round(most) > round(least) else f"{most:.0f}"
    return f"detects {spread} % of the falls"
