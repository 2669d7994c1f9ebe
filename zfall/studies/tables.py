"""Tables of a study: rows that differ in one thing, over seeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from zfall.evaluation.comparison import bootstrap_interval
from zfall.evaluation.definitions import Battery
from zfall.evaluation.statistics import summarize
from zfall.falling.kneeling import torso_or_head

# Column: its heading, and its digits.
Figures = Mapping[str, tuple[str, int]]
PLANAR: Figures = {
    "i50_mean": ("mean I50", 3),
    "i50_min": ("least I50", 2),
    "success": ("success", 3),
    "target_smoothness": ("smoothness [mrad]", 2),
    "joint_torque_rms": ("torque, smallest push [N m]", 2),
    "control_falls": ("falls without a push", 1),
    "frames_per_s": ("frames/s", 0),
}
KNEEL: Figures = {
    "recovered": ("recovered, small pushes", 3),
    "kneeled": ("kneeled, I = 1 to 1.5", 3),
    "clean": ("clean", 3),
    "untouched": ("untouched", 3),
    "kneeled_beyond": ("kneeled, larger", 3),
    "base_acceleration": ("acceleration [m/s2]", 0),
    "torso_head_force": ("force on torso, head [N]", 0),
    "control_falls": ("falls without a push", 1),
}
SMALL = 0.55  # pushes of the list up to it are to be recovered from
LARGE = 1.5  # up to it, they are to end in a kneel
UNPAIRED = ("frames_per_s", "control_falls")  # of which no difference is shown


@dataclass(frozen=True)
class Cell:
    """Mean over seeds, its bootstrap 95 % interval, and the paired difference to the first row.

    ``difference`` is ``None`` in the first row and where there is nothing to pair.
    """

    mean: float
    low: float
    high: float
    seeds: int
    difference: tuple[float, float, float] | None

    @property
    def distinct(self) -> bool:
        """Whether the interval of the difference excludes zero."""
        if self.difference is None:
            return False
        _, low, high = self.difference
        return low > 0 or high < 0


def planar_figures(battery: Battery, trials: pd.DataFrame, training_size: str) -> dict[str, float]:
    """``PLANAR`` but for the speed; success at the impulse of which training's pushes are."""
    summary = summarize(battery, trials)
    mild = trials[trials["impulse"] == trials["impulse"][trials["impulse"] > 0].min()]
    return {
        "i50_mean": summary["i50_mean"],
        "i50_min": summary["i50_min"],
        "success": summary["success"][training_size],
        "target_smoothness": 1e3 * summary["target_smoothness"],
        "joint_torque_rms": float(mild["joint_torque_rms"].mean()),
        "control_falls": summary["control_falls"],
    }


def kneel_figures(trials: pd.DataFrame) -> dict[str, float]:
    """``KNEEL``; not a number where there is nothing to count.

    Of the pushes up to I = 1.5 that were not recovered from: ``kneeled``, ``untouched`` (torso
    and head never on the floor) and, of the kneels, ``clean``. ``kneeled_beyond``: of larger ones.
    Peaks are means over all falls on the grid, which nobody recovers from: whoever gives up after
    small pushes must not gain by that.
    """
    pushed = trials[trials["impulse"] > 0]
    small = pushed[pushed["listed"] & (pushed["impulse"] < SMALL)]
    fallen = pushed[~pushed["recovered"] & ~pushed["listed"]]
    near, beyond = fallen[fallen["impulse"] <= LARGE], fallen[fallen["impulse"] > LARGE]
    force = fallen[["peak_contact_force/torso", "peak_contact_force/head"]].max(axis=1)
    values = {
        "recovered": small["recovered"],
        "kneeled": near["kneeled"],
        "clean": ~torso_or_head(near[near["kneeled"].astype(bool)]),
        "untouched": ~torso_or_head(near),
        "kneeled_beyond": beyond["kneeled"],
        "base_acceleration": fallen["peak_base_acceleration"],
        "torso_head_force": force,
    }
    means = {name: float(column.astype(float).mean()) for name, column in values.items()}
    return means | {"control_falls": int(trials["fell"][trials["impulse"] == 0].sum())}


def study_table(runs: Mapping[str, pd.DataFrame], figures: Figures) -> dict[str, dict[str, Cell]]:
    """Cells by row and figure.

    Args:
        runs: by row, the first to compare with; a line for each seed with ``seed`` and the
            figures. A row without lines is left out.
        figures: the columns, ``PLANAR`` or ``KNEEL``. A seed whose figure is not a number, for
            there was nothing to count, is left out of its mean.
    """
    base = next(iter(runs.values()))
    table: dict[str, dict[str, Cell]] = {}
    for name, rows in runs.items():
        if not len(rows):
            continue
        table[name] = {}
        for figure in figures:
            values = rows[figure].dropna().tolist() or [np.nan]
            low, high = bootstrap_interval(values)
            difference = None
            if rows is not base and len(base) and figure not in UNPAIRED:
                paired = rows.merge(base, on="seed", suffixes=("", "_base"))
                change = (paired[figure] - paired[f"{figure}_base"]).dropna().tolist()
                if len(change) > 1:
                    difference = (float(np.mean(change)), *bootstrap_interval(change))
            table[name][figure] = Cell(float(np.mean(values)), low, high, len(values), difference)
    return table


def as_markdown(
    table: Mapping[str, Mapping[str, Cell]], missing: Mapping[str, str], figures: Figures
) -> str:
    """The table in Markdown; rows of ``missing`` say why they are."""
    head = ["", *(heading for heading, _ in figures.values())]
    lines = [head, ["---"] * len(head)]
    for name, cells in table.items():
        lines.append([name, *(_text(cell, figures[key][1], "**") for key, cell in cells.items())])
    lines += [[name, why, *[""] * (len(head) - 2)] for name, why in missing.items()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def as_latex(
    table: Mapping[str, Mapping[str, Cell]], missing: Mapping[str, str], figures: Figures
) -> str:
    """The table for LaTeX with booktabs."""
    columns = "l" + "r" * len(figures)
    head = " & ".join(["", *(heading for heading, _ in figures.values())])
    body = []
    for name, cells in table.items():
        texts = [_text(cell, figures[key][1], "bold") for key, cell in cells.items()]
        body.append(" & ".join([name, *texts]) + r" \\")
    body += [
        rf"{name} & \multicolumn{{{len(figures)}}}{{l}}{{{why}}} \\"
        for name, why in missing.items()
    ]
    rows = "\n".join(body)
    return (
        (
            f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{head} \\\\\n\\midrule\n{rows}\n"
            "\\bottomrule\n\\end{tabular}\n"
        )
        .replace("%", r"\%")
        .replace("_", r"\_")
    )


def as_frame(table: Mapping[str, Mapping[str, Cell]]) -> pd.DataFrame:
    """The numbers, a line for each row and figure."""
    rows = []
    for name, cells in table.items():
        for figure, cell in cells.items():
            change: Sequence[float] = cell.difference or (np.nan, np.nan, np.nan)
            keys = ("difference", "difference_low", "difference_high")
            row = {"row": name, "figure": figure, "mean": cell.mean, "low": cell.low}
            rows.append(row | {"high": cell.high} | dict(zip(keys, change, strict=True)))
    return pd.DataFrame(rows)


def _text(cell: Cell, digits: int, bold: str) -> str:
    out = f"{cell.mean:.{digits}f}"
    if cell.seeds > 1:  # one says nothing of the others
        out += f" [{cell.low:.{digits}f}, {cell.high:.{digits}f}]"
    if cell.difference is not None:
        mean, low, high = cell.difference
        change = f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"
        if cell.distinct and float(f"{mean:.{digits}f}") != 0.0:
            change = rf"\textbf{{{change}}}" if bold == "bold" else f"{bold}{change}{bold}"
        out += f"; {change}"
    return out
