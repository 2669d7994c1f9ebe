"""Tables for LaTeX: what fits a column of a journal, what is escaped."""

import re
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from zfall.evaluation.latex import LatexCell, latex_of, latex_tables, latex_text

STUDIES = sorted((Path(__file__).parents[2] / "docs" / "studies").glob("*.tex"))
WIDE = [
    [LatexCell(f"row {k}, with a name that is long"), *[LatexCell("-12.345", "[-12.345, -12.345]", k == 1)] * 7]
    for k in range(3)
]  # fmt: skip
HEAD = ["", *(f"torque of joint {k}, smallest push [N m]" for k in range(7))]


def compiled(table: str, folder: Path) -> str:
    """The log of LaTeX for a table in the narrowest usual column, 3.2 inches."""
    lines = [r"\documentclass[10pt]{article}", r"\usepackage{booktabs}", r"\begin{document}",
             r"\hfuzz=0pt\begin{minipage}{229pt}", table, r"\end{minipage}", r"\end{document}"]  # fmt: skip
    (folder / "table.tex").write_text("\n".join(lines))
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "table.tex"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    return done.stdout


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex")
def test_tables_compile_and_none_is_wider_than_a_column(tmp_path):
    """LaTeX itself says what is too wide; of the studies' tables, too."""
    tables = [latex_tables(HEAD, [*WIDE, [LatexCell("last"), LatexCell("failed: " + "why " * 30)]])]
    tables += [path.read_text() for path in STUDIES]
    long = pd.DataFrame({"direction": range(96), "smallest": 0.25, "50 % & more": "a_b"})
    tables.append(latex_of(long))
    path = "runs/quickstart/2026-01-01_12-00-00-123456"
    tables.append(latex_of(pd.DataFrame({"run": [path, "best"], "success": 0.9, "p": 0.5})))
    for table in tables:
        log = compiled(table, tmp_path)
        assert "Overfull \\hbox" not in log, log[log.index("Overfull") :][:300]
    assert "Overfull" in compiled(latex_tables(HEAD, WIDE, width=900.0), tmp_path)


def test_columns_that_do_not_fit_go_on_below_with_the_names_again():
    """Every cell stands in just one part, each part has all rows."""
    rows = [[LatexCell(f"row {k}"), *(LatexCell(f"{k}.{c:04d}", "[-9.9999, +9.9999]") for c in range(8))] for k in range(3)]  # fmt: skip
    text = latex_tables(["", *(f"figure {c}" for c in range(8))], rows)
    parts = text.split(r"\begin{tabular}")[1:]
    assert len(parts) > 1
    for k in range(3):
        assert all(f"row {k}" in part for part in parts)
        assert [text.count(f"{k}.{c:04d}") for c in range(8)] == [1] * 8
    one = latex_tables(["", "a"], [[LatexCell("b"), LatexCell("1")]])
    assert one.count(r"\begin{tabular}") == 1


def test_a_long_table_is_split():
    text = latex_of(pd.DataFrame({"trial": range(96), "size": 0.5}))
    parts = text.split(r"\begin{tabular}")[1:]
    assert len(parts) == 3
    assert max(part.count(r"\\") for part in parts) <= 41
    for k in (0, 40, 95):
        assert len(re.findall(rf"^{k} & 0.5", text, re.MULTILINE)) == 1


def test_what_latex_reads_is_escaped_and_signs_are_those_of_print():
    assert latex_text("100 % _a & #1 {b}") == r"100 \% \_a \& \#1 \{b\}"
    assert latex_text("-0.5 [-1, 2] 2026-01-02") == "$-$0.5 [$-$1, 2] 2026-01-02"
    assert latex_text("acceleration [m/s2]") == "acceleration [m/s$^2$]"
    bold = latex_tables(["", "a"], [[LatexCell("b"), LatexCell("0.5", "[0, 1]", True)]])
    assert r"b & \textbf{0.5} \\" in bold
    assert r" & \scriptsize [0, 1] \\" in bold
