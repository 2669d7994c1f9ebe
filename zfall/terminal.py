"""What a terminal shows: tables that fit its width, and progress that keeps the time left."""

import io
import math
from dataclasses import dataclass
from typing import Any

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table
from rich.text import Text

QUIET = Console(quiet=True)
NAMES = 24  # characters that the first column keeps where there is little room


@dataclass(frozen=True)
class Sheet:
    """A table to print.

    Args:
        rows: the more important columns first; a cell may have several lines.
        title: above it.
        file: that has all columns, where some are left out.
    """

    rows: pd.DataFrame
    title: str = ""
    file: str = ""


def print_sheet(sheet: Sheet, console: Console) -> None:
    """Prints a table as wide as the terminal; last columns that do not fit are left out, and named.

    A pipe or a file gets all of it.
    """
    table, gone = fitted(sheet, console.width if console.is_terminal else None)
    if console.is_terminal:
        console.print(table)
    else:
        wide = Measurement.get(console, console.options.update(width=10_000), table).maximum
        plain = Console(file=io.StringIO(), width=max(wide, 1))
        plain.print(table)
        text = plain.file.getvalue()  # type: ignore[attr-defined]
        lines = "\n".join(line.rstrip() for line in text.rstrip().split("\n"))
        console.print(lines, markup=False, highlight=False, soft_wrap=True)
    if gone:
        where = f"; all are in {sheet.file}" if sheet.file else ""
        line = f"left out, as this terminal is narrow: {', '.join(gone)}{where}"
        console.print(line, markup=False, highlight=False)


def fitted(sheet: Sheet, width: int | None) -> tuple[Table, list[str]]:
    """The table with as many columns as fit, and the names of the others.

    Args:
        sheet: the table.
        width: in characters; ``None``: as wide as it must be.
    """
    names = [str(name) for name in sheet.rows.columns]
    measuring = Console(width=10_000)
    for count in range(len(names), 0, -1):
        table = _table(sheet, count, narrow=width is not None)
        needed = Measurement.get(measuring, measuring.options, table).minimum
        if width is None or needed <= width or count <= 2:
            return table, names[count:]
    return _table(sheet, 1, narrow=True), names[1:]


def _table(sheet: Sheet, count: int, *, narrow: bool) -> Table:
    """The first columns; ``narrow``: heads may be wrapped, and long names in the first column."""
    table = Table(
        title=Text(sheet.title, style="bold") if sheet.title else None,
        title_justify="left",
        box=SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    rows = sheet.rows.iloc[:, :count]
    texts = [[text_of(value) for value in rows.iloc[:, number]] for number in range(count)]
    for number, (name, cells) in enumerate(zip(rows.columns, texts, strict=True)):
        least = max([0, *(len(line) for cell in cells for line in cell.split("\n"))])
        if narrow and number == 0:
            least = min(least, NAMES)
        numeric = number > 0 and all(pd.api.types.is_number(x) for x in rows.iloc[:, number])
        right = numeric or (any(cell[:1].isdigit() for cell in cells) and number > 0)
        table.add_column(
            Text(str(name)),
            justify="right" if right else "left",
            min_width=least,
            no_wrap=not narrow,
            overflow="fold",
        )
    for row in zip(*texts, strict=True):
        table.add_row(*map(Text, row))
    return table


def text_of(value: Any) -> str:
    """A cell: numbers with three digits, what is not known as a dash."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


class Shortened(ProgressColumn):
    """A text of each task in one line, which gives way to the other columns.

    Args:
        text: a template, as ``{task.description}``.
        style: of it.
    """

    def __init__(self, text: str, style: str = ""):
        super().__init__(Column(ratio=None))
        self.text, self.style = text, style

    def render(self, task: Task) -> Text:
        """The text, to be cut off at the width of its column."""
        text = self.text.format(task=task)
        return Text(text, style=self.style, no_wrap=True, overflow="ellipsis")


def progress_bar(console: Console, *columns: ProgressColumn) -> Progress:
    """A bar with the time left, whatever the width: names and ``Shortened`` columns give way.

    Args:
        console: to show it on.
        columns: after the bar.
    """
    return Progress(
        Shortened("{task.description}", "bold"),
        BarColumn(bar_width=16, table_column=Column(no_wrap=True)),
        TimeElapsedColumn(Column(no_wrap=True)),
        TextColumn("left", table_column=Column(no_wrap=True)),
        TimeRemainingColumn(table_column=Column(no_wrap=True)),
        *columns,
        console=console,
    )
