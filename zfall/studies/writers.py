"""The files of a study: tables in Markdown, LaTeX and csv, and learning curves."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
from rich.console import Console

from zfall.evaluation.kinds import Figures, kind_of
from zfall.evaluation.latex import LatexCell, latex_tables
from zfall.evaluation.plots import learning_bands
from zfall.files import written_whole
from zfall.studies.plan import Run, battery_of
from zfall.studies.store import Store
from zfall.studies.tables import Cell, Rows, Table, arranged, tables_of
from zfall.terminal import Sheet, print_sheet

if TYPE_CHECKING:
    from zfall.studies.study import Study


def write_tables(
    study: "Study", store: Store, *, force: bool = False
) -> tuple[pd.DataFrame, list[Path]]:
    """Writes ``NAME.{md,tex,csv}`` from stored results alone, and of learning curves ``png, pdf``.

    Args:
        study: which.
        store: has the results.
        force: whether a table may have fewer finished runs than the one that it replaces.

    Returns:
        What the csv holds, and the files that are written.

    Raises:
        ValueError: if it would have fewer, naming what is missing and why.
    """
    figures = kind_of(battery_of(study)).study_figures
    tables = tables_of(study.plan, store, figures)
    frame = pd.concat([table.as_frame() for table in tables])
    place = store.results / study.name
    if not force:
        check_keeps_all(place.with_suffix(".csv"), frame, partial(_why, study.plan, store))
    texts, sources = [], []
    for table in tables:
        title = table.title
        head, comment = (f"Tested: {title}\n\n", f"% tested: {title}\n") if title else ("", "")
        texts.append(head + as_markdown(table.rows, table.missing, figures))
        sources.append(comment + as_latex(table.rows, table.missing, figures))
    store.results.mkdir(parents=True, exist_ok=True)
    paths = [store.results / f"{study.name}.{ending}" for ending in ("md", "tex", "csv")]
    contents = ["\n".join(texts), "\n".join(sources), frame.to_csv(index=False)]
    with ExitStack() as whole:  # after an error none of them is replaced
        for path, content in zip(paths, contents, strict=True):
            whole.enter_context(written_whole(path)).write_text(content)
        drawn = _write_curves(study.name, study.plan, store)
    return frame, [*paths, *drawn]


def check_keeps_all(path: Path, frame: pd.DataFrame, why: Callable[[str], str]) -> None:
    """Refuses a table with fewer finished runs of a row than the csv that it replaces.

    Args:
        path: of the csv.
        frame: what it would hold.
        why: of a row, by its name and perhaps test, says what is missing.

    Raises:
        ValueError: naming the first row that would lose runs, and why.
    """
    if not path.exists() or not path.read_text().strip():
        return
    old = pd.read_csv(path)
    if "row" not in old:
        raise ValueError(
            f"{path} must be the table of a study to be replaced, got one with columns "
            f"{', '.join(map(str, old))}; force=true replaces it all the same."
        )
    before, after = _finished(old), _finished(frame)
    lost = {row: count - after.get(row, 0) for row, count in before.items()}
    lost = {row: count for row, count in lost.items() if count > 0}
    if lost:
        first = next(iter(lost))
        raise ValueError(
            f"{path} must keep its {sum(before.values())} finished runs, "
            f"{sum(lost.values())} would be lost: {first}: {why(first)}; "
            "force=true writes it all the same."
        )


def _finished(frame: pd.DataFrame) -> dict[str, int]:
    """How many finished runs the rows of a csv have, each by its name and perhaps test."""
    if not len(frame):
        return {}
    seeds = frame["seeds"] if "seeds" in frame else pd.Series(1, index=frame.index)
    name = frame["row"].astype(str)
    if "test" in frame:
        name = name + " (" + frame["test"].astype(str) + ")"
    return {str(row): int(count) for row, count in seeds.groupby(name, sort=False).max().items()}


def _why(plan: Sequence[Run], store: Store, row: str) -> str:
    """What a row lacks, and why."""
    for title, cells in arranged(plan).items():
        for name, run, test in cells:
            if row in (name, f"{name} ({title})") and store.find(test) is None:
                return f"seed {run.seed} {store.why_missing(test)}, {store.nearest(test)}"
    return "no row and seed of the study any more"


def as_markdown(rows: Rows, missing: Mapping[str, str], figures: Figures) -> str:
    """The table in Markdown; rows of ``missing`` say why they are."""
    head = ["", *(heading for heading, _ in figures.values())]
    lines = [head, ["---"] * len(head)]
    for name, cells in rows.items():
        lines.append([name, *(_text(cell, figures[key][1]) for key, cell in cells.items())])
    lines += [[name, why, *[""] * (len(head) - 2)] for name, why in missing.items()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


# Of 95 %, nominally: over so few seeds it covers less.
OVER_SEEDS = "percentile bootstrap over seeds, of two or three their range"
NOTE = f"% below: {OVER_SEEDS}; bold: the paired difference to the first row excludes zero\n"


def as_latex(rows: Rows, missing: Mapping[str, str], figures: Figures) -> str:
    """The table for LaTeX, as wide as a column: means, below them their intervals.

    Bold is a mean whose paired difference to the first row excludes zero; these differences stand
    in the csv and in Markdown.
    """
    body = [
        [LatexCell(name), *(_latex_cell(cell, figures[key][1]) for key, cell in cells.items())]
        for name, cells in rows.items()
    ]
    body += [[LatexCell(name), LatexCell(why)] for name, why in missing.items()]
    return NOTE + latex_tables(["", *(heading for heading, _ in figures.values())], body)


def _latex_cell(cell: Cell, digits: int) -> LatexCell:
    below = f"[{cell.low:.{digits}f}, {cell.high:.{digits}f}]" if cell.seeds > 1 else ""
    return LatexCell(f"{cell.mean:.{digits}f}", below, _is_bold(cell, digits))


def sheet_of(table: Table, figures: Figures, **given: str) -> Sheet:
    """The table to print: means, below them their intervals, and ``*`` where LaTeX has bold."""
    lines = []
    for name, cells in table.rows.items():
        texts = [name]
        for key, cell in cells.items():
            each = _latex_cell(cell, figures[key][1])
            texts.append(f"{each.text}{'*' * each.bold}" + f"\n{each.below}" * bool(each.below))
        lines.append(texts)
    lines += [[name, why, *[""] * (len(figures) - 1)] for name, why in table.missing.items()]
    head = ["", *(heading for heading, _ in figures.values())]
    return Sheet(pd.DataFrame(lines, columns=head), **given)


def print_tables(study: "Study", store: Store, console: Console) -> None:
    """Prints the tables of a study, from stored results alone."""
    figures, file = kind_of(battery_of(study)).study_figures, store.results / f"{study.name}.md"
    for table in tables_of(study.plan, store, figures):
        title = f"{study.name}, tested: {table.title}" if table.title else study.name
        print_sheet(sheet_of(table, figures, title=title, file=str(file)), console)
    console.print(f"in brackets {OVER_SEEDS}; * the difference to the first row excludes zero")


def _text(cell: Cell, digits: int) -> str:
    """Mean, interval and difference; the latter bold if it excludes zero."""
    out = f"{cell.mean:.{digits}f}"
    if cell.seeds > 1:  # one says nothing of the others
        out += f" [{cell.low:.{digits}f}, {cell.high:.{digits}f}]"
    if cell.difference is not None:
        mean, low, high = cell.difference
        change = f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"
        out += f"; **{change}**" if _is_bold(cell, digits) else f"; {change}"
    return out


def _is_bold(cell: Cell, digits: int) -> bool:
    """Whether its difference to the first row excludes zero, and is any in the digits shown."""
    if cell.difference is None or not cell.distinct:
        return False
    return float(f"{cell.difference[0]:.{digits}f}") != 0.0


def _write_curves(name: str, runs: Sequence[Run], store: Store) -> list[Path]:
    """The learning curves with bands over seeds, of the rows that have any."""
    curves: dict[str, list[pd.DataFrame]] = {}
    for run in runs:
        if stored := store.find(run.tests[0]):
            curves.setdefault(run.row, []).append(stored.curve)
    paths = [store.results / f"{name}.{ending}" for ending in ("png", "pdf") if curves]
    for path in paths:
        learning_bands(curves, path, title=f"Study: {name.replace('_', ' ')}")
    return paths
