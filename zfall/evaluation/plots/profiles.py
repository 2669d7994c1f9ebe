"""Whole distributions in place of means."""

import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from zfall.evaluation.comparison import interquartile_mean, performance_profile
from zfall.evaluation.plots.colors import LINES
from zfall.evaluation.plots.headings import draw_heading
from zfall.evaluation.statistics import largest_withstood, success_table


def profiles_plot(runs: Mapping[str, pd.DataFrame], path: Path, *, title: str) -> None:
    """Share of directions in which I50 is at least as large, over its size: a line for each run.

    Performance profiles and interquartile means as in Agarwal et al., "Deep reinforcement learning
    at the edge of the statistical precipice", NeurIPS 2021, with directions for tasks.

    Args:
        runs: trials of one planar battery by name.
        path: file to write; its ending gives the format.
        title: above the plot; lines after the first are smaller.
    """
    figure = Figure(figsize=(8.0, max(3.6, 0.6 + 0.25 * len(runs))), layout="constrained")
    axes, most = figure.subplots(), 0.0
    for (name, trials), (style, color) in zip(runs.items(), itertools.cycle(LINES), strict=False):
        table = success_table(trials)
        sizes = table.columns.to_numpy()
        i50 = np.array([largest_withstood(sizes, rates, 0.5) for rates in table.to_numpy()])
        steps = np.concatenate([[0.0], sizes])
        share = performance_profile(i50, steps - 1e-6)  # at least, not more than
        label = f"{name}: IQM {interquartile_mean(i50):.2f}"
        axes.step(steps, share, style, markersize=3, where="pre", color=color, label=label)
        most = max(most, float(i50.max()))
    axes.set_xlim(0.0, most + 0.2)
    axes.set_xlabel("impulse I")
    axes.set_ylabel("share of directions with I50 ≥ I")
    draw_heading(figure, title)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", fontsize=9, frameon=False)
    figure.savefig(path, dpi=200)
