"""Learning curves for a page: drawn as SVG, with their values for a pointer that passes over."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from zfall.evaluation.plots.colors import LINES
from zfall.evaluation.plots.curves import running_mean

POINTS = 240  # of a curve
WIDTH, HEIGHT = 460, 220  # of a panel [px]
LEFT, RIGHT, TOP, BOTTOM = 52, 8, 8, 34  # its margins [px]
SIZE = {
    "width": WIDTH,
    "height": HEIGHT,
    "left": LEFT,
    "right": RIGHT,
    "top": TOP,
    "bottom": BOTTOM,
}
DASHES = {"--": "7 4", "-.": "8 3 2 3", ":": "2 3"}
PANELS = {
    "episode_return": "return of an episode",
    "episode_seconds": "length of an episode [s]",
    "kl": "KL divergence of an update",
}

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """A line of a panel.

    Attributes:
        name: in the legend.
        color: as CSS takes it.
        dashes: as SVG takes them; empty: none.
        path: of the running mean, in pixels.
        faint: of the values behind it.
        values: the running mean where ``Panel.frames`` are, as a list in JSON.
    """

    name: str
    color: str
    dashes: str
    path: str
    faint: str
    values: str


@dataclass(frozen=True)
class Panel:
    """A plot of one quantity over frames.

    Attributes:
        title: what it shows.
        curves: its lines.
        frames: of all points, in millions, as a list in JSON.
        across: ticks of the frames, places [px] and labels.
        up: ticks of the quantity.
    """

    title: str
    curves: list[Curve]
    frames: str
    across: list[tuple[float, str]]
    up: list[tuple[float, str]]


def panels(runs: Mapping[str, pd.DataFrame]) -> list[Panel]:
    """Return, length of episodes and divergence over frames; of one run its reward terms, too.

    Args:
        runs: rows of ``metrics.csv`` by the name of the run.
    """
    out = [
        _panel(title, {name: rows[["frames", key]] for name, rows in runs.items()})
        for key, title in PANELS.items()
        if all(key in rows and rows[key].notna().any() for rows in runs.values())
    ]
    (first, *others) = runs.values()
    terms = [str(key) for key in first if str(key).startswith("reward/")]
    if terms and not others:
        lines = {key.removeprefix("reward/"): first[["frames", key]] for key in terms}
        out.append(_panel("mean summand of the reward", lines))
    return out


def _panel(title: str, lines: Mapping[str, pd.DataFrame]) -> Panel:
    """A panel of columns over frames, each a frame with the two."""
    end = max(float(rows["frames"].max()) for rows in lines.values()) / 1e6
    frames = np.linspace(0.0, end, POINTS)
    thin = {name: _thinned(rows) for name, rows in lines.items()}
    seen = np.concatenate([np.concatenate([mean, raw]) for _, raw, mean in thin.values()])
    low, high = np.percentile(seen[np.isfinite(seen)], (0.5, 99.5))
    ticks = MaxNLocator(4).tick_values(low, high if high > low else low + 1.0)
    span = float(ticks[0]), float(ticks[-1])
    curves = []
    for number, (name, (own, raw, mean)) in enumerate(thin.items()):
        look, color = LINES[number % len(LINES)]
        dashes = next((DASHES[end] for end in DASHES if look.endswith(end)), "")
        values = np.interp(frames, own, mean, left=math.nan, right=math.nan)
        known = [float(f"{y:.4g}") if math.isfinite(y) else None for y in values]
        curves.append(
            Curve(
                name,
                "currentColor" if color == "#000000" else color,
                dashes,
                _path(own, mean, end, span),
                _path(own, raw, end, span),
                json.dumps(known, separators=(",", ":")),
            )
        )
    across = [(_x(tick, end), f"{tick:g}") for tick in MaxNLocator(5).tick_values(0.0, end)]
    return Panel(
        title,
        curves,
        json.dumps([float(f"{x:.4g}") for x in frames], separators=(",", ":")),
        [tick for tick in across if tick[0] <= WIDTH - RIGHT + 1],
        [(_y(tick, span), f"{tick:.4g}") for tick in ticks],
    )


def _thinned(rows: pd.DataFrame) -> tuple[Array, Array, Array]:
    """Frames in millions, values and their running mean, each in at most ``POINTS`` bins."""
    frames, values = (rows.iloc[:, k].astype(float) for k in (0, 1))
    columns = pd.DataFrame({"x": frames / 1e6, "raw": values, "mean": running_mean(values)})
    bins = np.arange(len(rows)) * min(POINTS, len(rows)) // max(len(rows), 1)
    x, raw, mean = columns.groupby(bins).mean().to_numpy().T
    return x, raw, mean


def _path(x: Array, y: Array, end: float, span: tuple[float, float]) -> str:
    """A line through points, broken where there is none, and cut off at the edges."""
    out, pen = [], "M"
    for across, up in zip(x, np.clip(y, *span), strict=True):
        if not math.isfinite(up):
            pen = "M"
            continue
        out.append(f"{pen}{_x(across, end):.1f} {_y(up, span):.1f}")
        pen = "L"
    return "".join(out)


def _x(frames: float, end: float) -> float:
    return LEFT + (WIDTH - LEFT - RIGHT) * frames / max(end, 1e-9)


def _y(value: float, span: tuple[float, float]) -> float:
    share = (value - span[0]) / (span[1] - span[0])
    return HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * share
