"""Statistics of a study: its rows over seeds, and what each differs from the first by."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from zfall.evaluation.comparison import bootstrap_interval
from zfall.evaluation.kinds import Figures
from zfall.studies.plan import Run, Test
from zfall.studies.store import Store

_COLUMNS = (
    *("row", "figure", "mean", "low", "high"),
    *("difference", "difference_low", "difference_high", "seeds"),
)
UNPAIRED = ("frames_per_s", "control_falls")  # of which no difference is shown


@dataclass(frozen=True)
class Cell:
    """Mean over seeds, its bootstrap 95 % interval, and the paired difference to the first row.

    ``difference`` is its mean and interval; ``None`` in the first row and where there is nothing
    to pair.
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


Rows = Mapping[str, Mapping[str, Cell]]  # by row and figure


@dataclass(frozen=True)
class Table:
    """The results in one world.

    Args:
        title: of the world; empty if each policy is tested in its own.
        rows: cells by row and figure.
        missing: by what has no results, why.
    """

    title: str
    rows: Rows
    missing: Mapping[str, str]

    def as_frame(self) -> pd.DataFrame:
        """A line for each row and figure, with the ``test`` if it has a title."""
        frame = as_frame(self.rows)
        if self.title:
            frame.insert(0, "test", self.title)
        return frame


def tables_of(runs: Sequence[Run], store: Store, figures: Figures) -> list[Table]:
    """The tables of a study, from stored results alone.

    One for each test, its rows those of the study; of a study with one row one, whose rows are
    the tests.
    """
    tables = []
    for title, cells in arranged(runs).items():
        lines: dict[str, list[dict[str, float]]] = {row: [] for row, _, _ in cells}
        missing: dict[str, str] = {}
        for row, run, test in cells:
            stored = store.find(test)
            if stored is not None:
                lines[row].append({**stored.figures, "seed": run.seed})
            else:
                missing[f"{row}, seed {run.seed}"] = store.why_missing(test)
        columns = ["seed", *figures]  # a figure that is newer than a result is NaN there
        joined = {row: pd.DataFrame(each).reindex(columns=columns) for row, each in lines.items()}
        tables.append(Table(title, study_table(joined, figures), missing))
    return tables


def arranged(runs: Sequence[Run]) -> dict[str, list[tuple[str, Run, Test]]]:
    """By title, the cells of each table: row, run and test."""
    one_row = len({run.row for run in runs}) == 1 and len(runs[0].tests) > 1
    tables: dict[str, list[tuple[str, Run, Test]]] = {}
    for number in range(len(runs[0].tests)):
        for run in runs:
            test = run.tests[number]
            title, row = ("", test.title) if one_row else (test.title, run.row)
            tables.setdefault(title, []).append((row, run, test))
    return tables


def study_table(runs: Mapping[str, pd.DataFrame], figures: Figures) -> Rows:
    """Cells by row and figure.

    Args:
        runs: by row, the first to compare with; a line for each seed with ``seed`` and the
            figures. A row without lines is left out.
        figures: the columns. A seed whose figure is NaN, as there was nothing to count, is left
            out of its mean.
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


def as_frame(rows: Rows) -> pd.DataFrame:
    """The numbers, a line for each row and figure."""
    lines = []
    for name, cells in rows.items():
        for figure, cell in cells.items():
            change: Sequence[float] = cell.difference or (np.nan, np.nan, np.nan)
            own = (name, figure, cell.mean, cell.low, cell.high)
            lines.append((*own, *change, cell.seeds))
    return pd.DataFrame(lines, columns=list(_COLUMNS))
