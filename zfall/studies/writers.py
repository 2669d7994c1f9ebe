"""The files of a study: tables in Markdown, LaTeX and csv, and learning curves."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import pandas as pd

from zfall.evaluation.kinds import Figures, kind_of
from zfall.evaluation.plots import learning_bands
from zfall.studies.plan import Run, battery_of
from zfall.studies.store import Store
from zfall.studies.tables import Cell, Rows, tables_of

if TYPE_CHECKING:
    from zfall.studies.study import Study


def write_tables(study: "Study", store: Store) -> pd.DataFrame:
    """Writes ``NAME.{md,tex,csv,png,pdf}`` from the files of finished tests alone.

    Returns:
        What the csv holds.
    """
    figures = kind_of(battery_of(study)).study_figures
    tables = tables_of(study.plan, store, figures)
    texts, sources = [], []
    for table in tables:
        title = table.title
        head, comment = (f"Tested: {title}\n\n", f"% tested: {title}\n") if title else ("", "")
        texts.append(head + as_markdown(table.rows, table.missing, figures))
        sources.append(comment + as_latex(table.rows, table.missing, figures))
    frame = pd.concat([table.as_frame() for table in tables])
    place = store.results / study.name
    place.with_name(f"{study.name}.md").write_text("\n".join(texts))
    place.with_name(f"{study.name}.tex").write_text("\n".join(sources))
    frame.to_csv(place.with_name(f"{study.name}.csv"), index=False)
    _write_curves(study.name, study.plan, store)
    return frame


def as_markdown(rows: Rows, missing: Mapping[str, str], figures: Figures) -> str:
    """The table in Markdown; rows of ``missing`` say why they are."""
    head = ["", *(heading for heading, _ in figures.values())]
    lines = [head, ["---"] * len(head)]
    for name, cells in rows.items():
        lines.append(
            [name, *(_text(cell, figures[key][1], "**{}**") for key, cell in cells.items())]
        )
    lines += [[name, why, *[""] * (len(head) - 2)] for name, why in missing.items()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def as_latex(rows: Rows, missing: Mapping[str, str], figures: Figures) -> str:
    """The table for LaTeX with booktabs."""
    columns = "l" + "r" * len(figures)
    head = " & ".join(["", *(heading for heading, _ in figures.values())])
    body = []
    for name, cells in rows.items():
        texts = [_text(cell, figures[key][1], r"\textbf{{{}}}") for key, cell in cells.items()]
        body.append(" & ".join([name, *texts]) + r" \\")
    body += [
        rf"{name} & \multicolumn{{{len(figures)}}}{{l}}{{{why}}} \\"
        for name, why in missing.items()
    ]
    lines = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", rf"{head} \\", r"\midrule"]
    lines += [*body, r"\bottomrule", r"\end{tabular}", ""]
    return "\n".join(lines).replace("%", r"\%").replace("_", r"\_")


def _text(cell: Cell, digits: int, bold: str) -> str:
    """Mean, interval and difference; the latter ``bold``, a template, if it excludes zero."""
    out = f"{cell.mean:.{digits}f}"
    if cell.seeds > 1:  # one says nothing of the others
        out += f" [{cell.low:.{digits}f}, {cell.high:.{digits}f}]"
    if cell.difference is not None:
        mean, low, high = cell.difference
        change = f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"
        if cell.distinct and float(f"{mean:.{digits}f}") != 0.0:
            change = bold.format(change)
        out += f"; {change}"
    return out


def _write_curves(name: str, runs: Sequence[Run], store: Store) -> None:
    """The learning curves with bands over seeds, of the rows that have any."""
    curves: dict[str, list[pd.DataFrame]] = {}
    for run in runs:
        test = run.tests[0]
        if store.result(test).exists():
            curves.setdefault(run.row, []).append(pd.read_csv(store.curve(test)))
    for ending in ("png", "pdf") if curves else ():
        learning_bands(curves, store.results / f"{name}.{ending}", title=name)
