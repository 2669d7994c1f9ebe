"""Rows of a run's csv files: added one by one, and read back even where a file was damaged."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from zfall.files import written_whole


def append_row(path: Path, row: dict[str, Any]) -> list[str]:
    """Adds a row to a csv file, with a header if it is the first; returns the columns.

    Columns that are new, in a run that an older version of this program began, are empty in the
    rows before.
    """
    columns = list(row)
    if path.exists():
        with path.open(newline="") as file:
            reader = csv.DictReader(file)
            there = list(reader.fieldnames or ())
            if there != columns:
                columns += [name for name in there if name not in row]
                with written_whole(path) as new:
                    new.write_text(_as_csv(columns, reader))
        row = dict.fromkeys(columns) | row
    else:
        path.write_text(_as_csv(columns, ()))
    with path.open("a", newline="") as file:
        file.write(_as_csv(columns, (row,), header=False))
    return columns


def keep_rows(path: Path, columns: Sequence[str], updates: int) -> int:
    """Leaves of a csv file the sound rows of the updates 1 to ``updates``, in their order.

    A row is sound if its line is whole, all its cells are numbers or empty, and there are as many
    as columns. The file is written anew, with its header, only if that changes it.

    Args:
        path: the file, whose first column is the number of the update; it may be missing.
        columns: of its header; none: those that its first line names, as also if it has more.
        updates: the last one to keep.

    Returns:
        How many updates have no sound row.
    """
    old = path.read_bytes() if path.exists() else b""
    lines = old.decode(errors="replace").split("\n")[:-1]  # what has no end was cut off
    header = lines[0].split(",") if lines else []
    if not columns or set(columns) < set(header):  # a stage that begins may bring columns
        columns = header
    rows: list[str] = []
    last = 0
    for number, line in _rows_of(lines, len(columns)):
        if last < number <= updates:
            rows.append(line)
            last = number
    text = "".join(f"{line}\n" for line in (",".join(columns), *rows))
    if not rows:
        path.unlink(missing_ok=True)  # the next row brings the header
    elif text.encode() != old:
        with written_whole(path) as new:
            new.write_text(text)
    return updates - len(rows)


def _rows_of(lines: Sequence[str], columns: int) -> Iterator[tuple[int, str]]:
    """Lines that are rows, each with the number of its update."""
    for line in lines:
        cells = line.split(",")
        with suppress(ValueError):  # not a number
            numbers = [float(cell) for cell in cells if cell]
            if len(cells) == columns and cells[0].isdecimal() and numbers:
                yield int(cells[0]), line


def _as_csv(columns: Sequence[str], rows: Iterable[dict[str, Any]], header: bool = True) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=columns, lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
