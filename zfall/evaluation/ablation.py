"""Tables of a study: rows that differ in one thing, over seeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from zfall.evaluation.comparison import bootstrap_interval

# Column: its heading, and its digits.
FIGURES = {
    "i50_mean": ("mean I50", 3),
    "i50_min": ("least I50", 2),
    "success": ("success", 3),
    "target_smoothness": ("smoothness [mrad]", 2),
    "joint_torque_rms": ("torque, smallest push [N m]", 2),
    "control_falls": ("falls without a push", 1),
    "frames_per_s": ("frames/s", 0),
}
UNPAIRED = ("frames_per_s", "control_falls")  # of which no difference is shown


@dataclass(frozen=True)
class Cell:
    """Mean over seeds, its bootstrap 95 % interval, and the paired difference to the first row.

    ``difference`` is ``None`` in the first row and where there is nothing to pair.
    """

    mean: float
    low: float
    high: float
    difference: tuple[float, float, float] | None

    @property
    def distinct(self) -> bool:
        """Whether the interval of the difference excludes zero."""
        if self.difference is None:
            return False
        _, low, high = self.difference
        return low > 0 or high < 0


def study_table(runs: Mapping[str, pd.DataFrame]) -> dict[str, dict[str, Cell]]:
    """Cells by row and figure.

    Args:
        runs: by row, the first to compare with; a line for each seed with ``seed`` and the
            ``FIGURES``. A row without lines is left out.
    """
    base = next(iter(runs.values()))
    table: dict[str, dict[str, Cell]] = {}
    for name, rows in runs.items():
        if not len(rows):
            continue
        table[name] = {}
        for figure in FIGURES:
            values = rows[figure].tolist()
            low, high = bootstrap_interval(values)
            difference = None
            if rows is not base and len(base) and figure not in UNPAIRED:
                paired = rows.merge(base, on="seed", suffixes=("", "_base"))
                change = (paired[figure] - paired[f"{figure}_base"]).tolist()
                if len(change) > 1:
                    difference = (float(np.mean(change)), *bootstrap_interval(change))
            table[name][figure] = Cell(float(np.mean(values)), low, high, difference)
    return table


def as_markdown(table: Mapping[str, Mapping[str, Cell]], missing: Mapping[str, str]) -> str:
    """The table in Markdown; rows of ``missing`` say why they are."""
    head = ["", *(heading for heading, _ in FIGURES.values())]
    lines = [head, ["---"] * len(head)]
    for name, cells in table.items():
        lines.append([name, *(_text(cell, FIGURES[key][1], "**") for key, cell in cells.items())])
    lines += [[name, why, *[""] * (len(head) - 2)] for name, why in missing.items()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def as_latex(table: Mapping[str, Mapping[str, Cell]], missing: Mapping[str, str]) -> str:
    """The table for LaTeX with booktabs."""
    columns = "l" + "r" * len(FIGURES)
    head = " & ".join(["", *(heading for heading, _ in FIGURES.values())])
    body = []
    for name, cells in table.items():
        texts = [_text(cell, FIGURES[key][1], "bold") for key, cell in cells.items()]
        body.append(" & ".join([name, *texts]) + r" \\")
    body += [
        rf"{name} & \multicolumn{{{len(FIGURES)}}}{{l}}{{{why}}} \\"
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
    out = f"{cell.mean:.{digits}f} [{cell.low:.{digits}f}, {cell.high:.{digits}f}]"
    if cell.difference is not None:
        mean, low, high = cell.difference
        change = f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"
        if cell.distinct:
            change = rf"\textbf{{{change}}}" if bold == "bold" else f"{bold}{change}{bold}"
        out += f"; {change}"
    return out
