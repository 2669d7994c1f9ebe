"""Files of results: summaries in JSON, tables for readers and programs, figures."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from zfall.evaluation.latex import latex_of
from zfall.terminal import Sheet, text_of

FORMATS = ("png", "pdf")


@dataclass
class Written:
    """What a kind of battery wrote.

    Args:
        files: their names.
        shown: what to print, one after the other: texts as they are, or tables.
    """

    files: list[str] = field(default_factory=list)
    shown: list[str | Sheet] = field(default_factory=list)


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Writes ``summary.json``; NaN becomes null, for which JSON has a word."""
    (folder / "summary.json").write_text(json.dumps(_known(summary), indent=2, allow_nan=False))


def _known(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _known(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_known(entry) for entry in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def write_figures(folder: Path, name: str, draw: Callable[[Path], None]) -> list[str]:
    """Draws a figure in all formats; returns the files' names."""
    for ending in FORMATS:
        draw(folder / f"{name}.{ending}")
    return [f"{name}.{ending}" for ending in FORMATS]


def write_table(folder: Path, name: str, rows: pd.DataFrame) -> list[str]:
    """Writes a table as csv, which the report shows, Markdown and LaTeX; returns their names."""
    rows.to_csv(folder / f"{name}.csv", index=False)
    (folder / f"{name}.md").write_text(markdown(rows))
    (folder / f"{name}.tex").write_text(latex_of(rows))
    return [f"{name}.{ending}" for ending in ("csv", "md", "tex")]


def markdown(rows: pd.DataFrame) -> str:
    """A table in Markdown, numbers with three digits."""
    cells = rows.map(text_of)
    lines = [list(rows.columns), ["---"] * rows.shape[1], *cells.to_numpy().tolist()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
