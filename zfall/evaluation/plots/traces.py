"""What a joint did during a trial."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from zfall.evaluation.plots.colors import LINES


def trace_plot(
    traces: Mapping[str, pd.DataFrame],
    path: Path,
    *,
    joint: str,
    pushes: Sequence[tuple[float, float]],
) -> None:
    """Target velocity, target, position and torque of a joint, a line for each run.

    The target velocity is the difference of targets over a control step. After Duburcq et al.,
    IROS 2022, figure 6.

    Args:
        traces: by name, rows with ``time_s`` and ``target``, ``position`` [rad] and ``torque``
            [N m] of the joint.
        path: file to write; its ending gives the format.
        joint: its name.
        pushes: when each begins and ends [s].
    """
    figure = Figure(figsize=(3.5, 4.7 + 0.15 * len(traces)), layout="constrained")
    panels = figure.subplots(4, 1, sharex=True)
    labels = {
        "target_velocity": "target [rad/s]",
        "target": "target [rad]",
        "position": "position [rad]",
        "torque": "torque [N m]",
    }
    moving = {
        name: rows.assign(target_velocity=rows["target"].diff() / rows["time_s"].diff())
        for name, rows in traces.items()
    }
    for axes, (key, label) in zip(panels, labels.items(), strict=True):
        for push in pushes:
            axes.axvspan(*push, color="0.88", lw=0)
        lines = zip(moving.items(), itertools.cycle(LINES), strict=False)
        for (name, rows), (style, color) in lines:
            (line,) = axes.plot(
                rows["time_s"], rows[key], style, color=color, lw=1, markevery=5, ms=3
            )
            line.set_label(name)
        axes.set_ylabel(label, fontsize=8)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
    title = f"{joint}; pushes are shaded" if pushes else f"{joint}; no push"
    panels[0].set_title(title, fontsize=8, loc="left")
    panels[-1].set_xlabel("time [s]", fontsize=8)
    names = panels[0].get_legend_handles_labels()
    figure.legend(*names, loc="outside lower center", fontsize=7, frameon=False)
    figure.savefig(path, dpi=300)
