"""Logs of a servo next to what was fitted to them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from zfall.evaluation.plots.colors import VERMILION
from zfall.robots.servos.logs import ServoLog


def fit_plot(
    logs: Sequence[ServoLog],
    positions: Sequence[NDArray[np.float64]],
    path: Path,
    *,
    resolution: float,
) -> None:
    """Target, log and fitted servo over time, and below what is left between the two.

    Args:
        logs: a column for each.
        positions: of the fitted servo at the times of each log ``(T,)`` [rad].
        path: file to write; its ending gives the format.
        resolution: of the encoder, which is shaded where errors of its rounding lie [rad].
    """
    figure = Figure(figsize=(0.8 + 3.6 * len(logs), 4.2), layout="constrained")
    panels = figure.subplots(
        2, len(logs), squeeze=False, sharex="col", sharey="row", height_ratios=[2, 1]
    )
    for (above, below), log, fitted in zip(panels.T, logs, positions, strict=True):
        above.step(log.time, log.target, where="post", color="0.75", lw=1, label="target")
        above.plot(log.time, log.position, color="k", lw=2.2, label="log")
        above.plot(log.time, fitted, color=VERMILION, lw=1, label="fitted servo")
        error = 1e3 * (log.position - fitted)
        half = 500 * resolution
        below.axhspan(-half, half, color="0.9", lw=0, label="half a step of the encoder")
        below.plot(log.time, error, color=VERMILION, lw=0.7)
        rms = float(np.sqrt(np.mean(error**2)))
        above.set_title(f"{log.name}: {rms:.2f} mrad rms", fontsize=9)
        below.set_xlabel("time [s]", fontsize=8)
        for axes in (above, below):
            axes.tick_params(labelsize=7)
            axes.grid(alpha=0.3)
    panels[0, 0].set_ylabel("position [rad]", fontsize=8)
    panels[1, 0].set_ylabel("log - fitted [mrad]", fontsize=8)
    lines = [*panels[0, 0].get_legend_handles_labels(), *panels[1, 0].get_legend_handles_labels()]
    handles, names = lines[0] + lines[2], lines[1] + lines[3]
    figure.legend(handles, names, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    figure.savefig(path, dpi=150)
