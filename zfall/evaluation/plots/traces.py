"""What a joint did during a trial."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from zfall.evaluation.plots.colors import LINES, SKY

MOTIONS = {"pitch": "forward and back", "roll": "sideways", "yaw": "turning"}
BEFORE, AFTER = 0.5, 0.9  # of a push [s]


def trace_plot(
    traces: Mapping[str, pd.DataFrame],
    path: Path,
    *,
    joint: str,
    pushes: Sequence[tuple[float, float]],
    limit: float | None = None,
) -> None:
    """Target velocity, target, position and torque of a joint, a line for each run.

    The target velocity is the difference of targets over a control step. Target and position have
    one scale. Of a single push half a second before and one after it are shown. After Duburcq et
    al., IROS 2022, figure 6.

    Args:
        traces: by name, rows with ``time_s`` and ``target``, ``position`` [rad] and ``torque``
            [N m] of the joint.
        path: file to write; its ending gives the format.
        joint: its name.
        pushes: when each begins and ends [s].
        limit: the largest torque of the joint, drawn on both sides [N m]; ``None``: not known.
    """
    figure = Figure(figsize=(7.5, 5.6 + 0.15 * len(traces)), layout="constrained")
    panels = figure.subplots(4, 1, sharex=True)
    panels[2].sharey(panels[1])
    labels = {
        "target_velocity": "target\nspeed [rad/s]",
        "target": "target\n[rad]",
        "position": "position\n[rad]",
        "torque": "torque\n[N m]",
    }
    moving = {
        name: rows.assign(target_velocity=rows["target"].diff() / rows["time_s"].diff())
        for name, rows in traces.items()
    }
    for axes, (key, label) in zip(panels, labels.items(), strict=True):
        for push in pushes:
            axes.axvspan(*push, color=SKY, alpha=0.45, lw=0)
        lines = zip(moving.items(), itertools.cycle(LINES), strict=False)
        for (name, rows), (style, color) in lines:
            (line,) = axes.plot(
                rows["time_s"], rows[key], style, color=color, lw=1, markevery=5, ms=3
            )
            line.set_label(name)
        axes.set_ylabel(label, fontsize=9)
        axes.tick_params(labelsize=9)
        axes.grid(alpha=0.3)
    if limit is not None:
        for sign in (-1.0, 1.0):
            bound = panels[3].axhline(sign * limit, color="0.3", lw=0.9, ls=(0, (6, 3)))
        bound.set_label(f"largest torque, {limit:.3g} N m")
    if len(pushes) == 1:
        ((begin, end),) = pushes
        panels[0].set_xlim(begin - BEFORE, end + AFTER)
    title = f"{plain(joint)}; {'pushes are' if len(pushes) > 1 else 'the push is'} blue"
    panels[0].set_title(title if pushes else f"{plain(joint)}; no push", fontsize=10, loc="left")
    panels[-1].set_xlabel("time [s]", fontsize=9)
    names = panels[3].get_legend_handles_labels()
    figure.legend(*names, loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    figure.savefig(path, dpi=200)


def plain(joint: str) -> str:
    """A joint in plain words: ``left hip, forward and back`` of ``left_hip_pitch``."""
    *place, last = joint.removesuffix("_joint").split("_")
    if not place or last not in MOTIONS:
        return joint.replace("_", " ")
    return f"{' '.join(place)}, {MOTIONS[last]}"
