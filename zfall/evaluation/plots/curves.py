"""How learning went."""

import itertools
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from zfall.evaluation.comparison import bootstrap_interval
from zfall.evaluation.plots.colors import LINES
from zfall.files import written_whole

POINTS = 40  # at which curves of several seeds are averaged
FEW = 4  # seeds from which on an interval of their mean is drawn


def learning_curves(metrics: pd.DataFrame | Mapping[str, pd.DataFrame], path: Path) -> None:
    """Return, episode length, KL divergence and reward terms over control steps.

    A bold line is the mean over about a thirtieth of the training, the faint one behind it the
    values. Of several runs the terms are left out, and each has its colour and dashes.

    Args:
        metrics: rows of a run's ``metrics.csv``, or of several by their names.
        path: file to write.
    """
    runs = {"": metrics} if isinstance(metrics, pd.DataFrame) else dict(metrics)
    figure = Figure(figsize=(9, 5.8), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    for ax, key, label in (
        (axes[0, 0], "episode_return", "return of an episode"),
        (axes[0, 1], "episode_seconds", "length of an episode [s]"),
        (axes[1, 0], "kl", "KL divergence of an update"),
    ):
        for (name, rows), look in zip(runs.items(), itertools.cycle(LINES), strict=False):
            _smoothed(ax, rows, key, name, look)
        ax.set_ylabel(label)
    below = axes[1, 1]
    if len(runs) == 1:
        (rows,) = runs.values()
        terms = [str(k) for k in rows if str(k).startswith("reward/")]
        for key, look in zip(terms, itertools.cycle(LINES), strict=False):
            _smoothed(below, rows, key, key.removeprefix("reward/"), look)
        below.set_ylabel("mean summand of the reward")
    else:
        below.set_axis_off()
    handles, names = (below if len(runs) == 1 else axes[0, 0]).get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", fontsize=8, ncols=4, frameon=False)
    for ax in axes.flat:
        ax.grid(alpha=0.3)
    for ax in (axes[1, 0], below if len(runs) == 1 else axes[0, 1]):
        ax.set_xlabel("control steps [millions]")
        ax.tick_params(labelbottom=True)
    figure.savefig(path, dpi=130)


def _smoothed(axes: Any, rows: pd.DataFrame, key: str, name: str, look: tuple[str, str]) -> None:
    """A column over the control steps: its running mean, and the values faint behind it."""
    frames, (style, color) = rows["frames"] / 1e6, look
    mean = running_mean(rows[key])
    axes.plot(frames, rows[key], lw=0.7, color=color, alpha=0.3)
    every = max(1, len(rows) // 8)
    axes.plot(frames, mean, style, lw=1.5, ms=4, markevery=every, color=color, label=name)


def running_mean(values: pd.Series) -> pd.Series:
    """Means over about a thirtieth of all values."""
    window = max(1, len(values) // 30)
    return values.rolling(window, center=True, min_periods=1).mean()


def learning_bands(
    groups: Mapping[str, Sequence[pd.DataFrame]],
    path: Path,
    *,
    key: str = "episode_seconds",
    label: str = "length of an episode [s]",
    title: str = "",
) -> None:
    """Mean over seeds, over control steps, a line for each group.

    Four seeds or more have a band, the bootstrap 95 % interval of their mean. Fewer say little of
    others: their band is their range, and each is a thin line. One seed has no band.

    Args:
        groups: rows of the ``metrics.csv`` of several seeds, by the name of what they share.
        path: file to write; its ending gives the format.
        key: column to show, in means over a fortieth of the training.
        label: of its axis.
        title: above the plot.
    """
    figure = Figure(figsize=(3.5, 2.7), layout="constrained")
    axes = figure.subplots()
    for (name, runs), (style, color) in zip(groups.items(), itertools.cycle(LINES), strict=False):
        end = min(float(run["frames"].max()) for run in runs)
        edges = np.linspace(0.0, end, POINTS + 1)
        curves = np.array([_binned(run, key, edges) for run in runs])
        frames = 0.5 * (edges[1:] + edges[:-1]) / 1e6
        (curve,) = axes.plot(frames, curves.mean(0), style, color=color, lw=1.4, markevery=5, ms=3)
        curve.set_label(f"{name} ({len(runs)})")
        if len(runs) >= FEW:
            low, high = np.array([bootstrap_interval(x, resamples=999) for x in curves.T]).T
        else:
            low, high = curves.min(0), curves.max(0)
        if len(runs) > 1:
            axes.fill_between(frames, low, high, color=color, alpha=0.18, lw=0)
        for single in curves if 1 < len(runs) < FEW else ():
            axes.plot(frames, single, color=color, lw=0.5, alpha=0.7)
    axes.set_xlabel("control steps [millions]", fontsize=8)
    axes.set_ylabel(label, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.set_title(title, fontsize=9)
    axes.grid(alpha=0.3)
    place: dict[str, Any] = {}
    if len(groups) > 4 or max(map(len, groups)) > 24:  # names would cover what they name
        figure.set_size_inches(5.4, 2.7)
        place = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "borderaxespad": 0.0}
    axes.legend(fontsize=7, title=_band(groups.values()), title_fontsize=7, **place)
    # Without its date, the same curves give the same file.
    metadata = {"CreationDate": None} if path.suffix == ".pdf" else None
    with written_whole(path) as new:
        figure.savefig(new, format=path.suffix[1:], dpi=300, metadata=metadata)


def _band(groups: Collection[Sequence[pd.DataFrame]]) -> str:
    """What line and band are, in words; the number of seeds stands in brackets behind a name."""
    sizes = [len(runs) for runs in groups]
    if max(sizes) == 1:
        return "one seed"
    if min(sizes) >= FEW:
        return "mean and 95 % interval (seeds)"
    if max(sizes) < FEW:
        return "mean and range (seeds)"
    return f"mean; 95 % interval, or range\nof fewer than {FEW} seeds (seeds)"


def learning_table(groups: Mapping[str, Sequence[pd.DataFrame]]) -> pd.DataFrame:
    """What ``learning_bands`` draws of returns and lengths of episodes, as numbers.

    Rows: ``name``, ``frames`` and, of ``episode_return`` and ``episode_seconds`` [s], the mean over
    the runs of a group, their least and their greatest (``_low``, ``_high``).

    Args:
        groups: as there.
    """
    tables = []
    for name, runs in groups.items():
        edges = np.linspace(0.0, min(float(run["frames"].max()) for run in runs), POINTS + 1)
        columns: dict[str, Any] = {"name": name, "frames": 0.5 * (edges[1:] + edges[:-1])}
        for key in ("episode_return", "episode_seconds"):
            curves = np.array([_binned(run, key, edges) for run in runs])
            columns |= {key: curves.mean(0)}
            columns |= {f"{key}_low": curves.min(0), f"{key}_high": curves.max(0)}
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def _binned(run: pd.DataFrame, key: str, edges: np.ndarray) -> np.ndarray:
    """Means of a column between edges ``(K,)`` of the frames; gaps take their neighbours' line."""
    bins = np.digitize(run["frames"], edges[1:], right=True)
    means = run.groupby(bins)[key].mean().reindex(range(len(edges) - 1))
    return np.asarray(means.interpolate(limit_direction="both"), dtype=float)
