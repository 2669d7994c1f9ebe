"""Maps over the size and duration of pushes."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from zfall.evaluation.plots.headings import draw_heading
from zfall.evaluation.statistics import withstood_table

NEARLY_NONE = 0.1  # share of the episodes that end in a fall


def withstood_map(trials: pd.DataFrame, path: Path, *, title: str) -> None:
    """Mean number of pushes withstood in a row, a map of size and duration for each push point.

    After Ferigo et al., RA-L 2021, figure 5. A white frame marks cells in which nearly all that
    came was withstood: at most a tenth of the episodes ended in a fall, so that the number says
    how many pushes came.

    Args:
        trials: of battery ``spherical``.
        path: file to write; its ending gives the format.
        title: above the plots.
    """
    table = withstood_table(trials)
    bodies = list(dict.fromkeys(table["body"]))
    most = float(table["withstood"].max())
    figure = Figure(figsize=(max(6.5, 2.4 * len(bodies) + 0.8), 3.3), layout="constrained")
    panels = figure.subplots(1, len(bodies), squeeze=False)[0]
    for axes, body in zip(panels, bodies, strict=True):
        cells = table[table["body"] == body].pivot(
            index="duration_s", columns="impulse", values="withstood"
        )
        image = axes.imshow(
            cells.to_numpy(), cmap="cividis", vmin=0, vmax=most, origin="lower", aspect="auto"
        )
        for (row, column), value in ((k, cells.iloc[k]) for k in _places(cells)):
            color = "black" if value > 0.6 * most else "white"
            axes.text(
                column, row, f"{value:.1f}", ha="center", va="center", color=color, fontsize=9
            )
        fell = table[table["body"] == body].pivot(
            index="duration_s", columns="impulse", values="fell"
        )
        for row, column in zip(*np.nonzero(fell.to_numpy() <= NEARLY_NONE), strict=True):
            inside = (column - 0.46, row - 0.46), 0.92, 0.92
            axes.add_patch(Rectangle(*inside, fill=False, ec="white", lw=2.5))
            axes.add_patch(Rectangle(*inside, fill=False, ec="black", lw=0.8))
        axes.set_xticks(range(cells.shape[1]), [f"{i:g}" for i in cells.columns], fontsize=9)
        axes.set_yticks(range(cells.shape[0]), [f"{d:g}" for d in cells.index], fontsize=9)
        axes.set_xlabel("impulse I", fontsize=9)
        axes.set_title(f"pushed at the {str(body).replace('_', ' ')}", fontsize=10)
    panels[0].set_ylabel("duration [s]", fontsize=9)
    share = f"{100 * NEARLY_NONE:.0f} %"
    note = f"framed: withstood nearly all that came, at most {share} of the episodes end in a fall"
    figure.supxlabel(note, fontsize=9)
    bar = figure.colorbar(image, ax=panels)
    bar.set_label("pushes in a row", fontsize=9)
    bar.ax.tick_params(labelsize=9)
    draw_heading(figure, title)
    figure.savefig(path, dpi=300)


def _places(cells: pd.DataFrame) -> list[tuple[int, int]]:
    return [(row, column) for row in range(cells.shape[0]) for column in range(cells.shape[1])]
