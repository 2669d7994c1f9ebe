r"""Tables for LaTeX that fit a column of a two-column paper, with booktabs.

Text is in ``\footnotesize``, intervals below it in ``\scriptsize``. What is too wide goes on in
another ``tabular`` below, what is too long as well. Needs the package booktabs.
"""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from zfall.terminal import text_of

COLUMN = 229.0  # of LaTeX's own two-column pages; those of ACM and IEEE have 241 and 252 [pt]
NAMES = 72.0  # the most that the names of the rows take of it [pt]
GAP = 3.0  # on either side of a cell [pt]
ROWS = 40  # of a tabular, with what stands below them
HEAD = 10  # characters in a line of a head
TEXT, SMALL = 8.0, 7.0  # sizes of the fonts [pt]

LINE = r"\\{}"  # a new one within a cell; no optional argument

_ESCAPED = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_ESCAPED |= {sign: rf"\{sign}" for sign in "%_&#${}"}


@dataclass(frozen=True)
class LatexCell:
    """A cell.

    Args:
        text: as it is to be read; ``latex_tables`` escapes it.
        below: in a smaller font under it.
        bold: whether the text is.
    """

    text: str
    below: str = ""
    bold: bool = False


def latex_tables(
    head: Sequence[str], rows: Sequence[Sequence[LatexCell]], *, width: float = COLUMN
) -> str:
    """One or more tabulars of the rows.

    Args:
        head: of the columns, the first that of the names.
        rows: cells, one for each column; a row with a name and one more cell has that over all.
        width: that is not to be passed [pt].
    """
    parts, lines = [], [r"{\footnotesize\setlength{\tabcolsep}{3pt}%"]
    names = min(NAMES, max([_width(head[0]), *(_width(row[0].text) for row in rows)]))
    whole = [row for row in rows if len(row) == len(head)]
    widths = [_column(head[k], [row[k] for row in whole]) for k in range(1, len(head))]
    for columns in _blocks(widths, width - names):
        for begin in range(0, max(1, len(rows)), _fit(rows)):
            parts.append(_tabular(head, rows[begin : begin + _fit(rows)], columns, names, width))
    lines.append("\n\\par\\medskip\n".join(parts))
    return "\n".join([*lines, "}", ""])


def latex_of(rows: pd.DataFrame) -> str:
    """The tabulars of a data frame; its first column names the rows."""
    cells = [[LatexCell(text_of(value)) for value in row] for row in rows.to_numpy().tolist()]
    return latex_tables([str(name) for name in rows.columns], cells)


def latex_text(text: str) -> str:
    r"""Text with LaTeX's signs escaped; ``-0.1`` and ``m/s2`` as they are set in print."""
    out = "".join(_ESCAPED.get(sign, sign) for sign in text)
    out = re.sub(r"(?<![\w.])-(?=\d)", "$-$", out)
    return re.sub(r"(?<=/s)2\b", "$^2$", out)


def _fit(rows: Sequence[Sequence[LatexCell]]) -> int:
    """Rows of one tabular."""
    tall = any(cell.below for row in rows for cell in row)
    return ROWS // 2 if tall else ROWS


def _width(text: str, size: float = TEXT) -> float:
    """A bound of the width of a text [pt]: signs of Computer Modern, the widest of the usual."""
    narrow = sum(sign in " .,;:'|()[]ijltfr-!/" for sign in text)
    broad = sum(sign in "mwMW%+" or sign.isupper() for sign in text)
    return size * (0.4 * narrow + 0.85 * broad + 0.56 * (len(text) - narrow - broad))


def _heads(text: str) -> list[str]:
    """A head in lines, with its unit unbroken."""
    whole = re.sub(r"\[[^]]*\]", lambda unit: unit[0].replace(" ", "\0"), text)
    lines = textwrap.wrap(whole, HEAD, break_long_words=False, break_on_hyphens=False)
    return [line.replace("\0", " ") for line in lines] or [""]


def _name(text: str, width: float) -> list[str]:
    """The name of a row in lines no wider than that [pt]; a path is broken where it must be."""
    lines = [""]
    for word in text.split(" "):
        longer = f"{lines[-1]} {word}".strip()
        if not lines[-1] or _width(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
        while _width(lines[-1]) > width and len(lines[-1]) > 1:
            fits = max(1, sum(_width(lines[-1][:k]) <= width for k in range(1, len(lines[-1]))))
            lines[-1:] = [lines[-1][:fits], lines[-1][fits:]]
    return lines


def _column(head: str, cells: Sequence[LatexCell]) -> float:
    """The width of a column with its gaps [pt]."""
    texts = [_width(line) for line in _heads(head)]
    texts += [_width(cell.text) * (1.15 if cell.bold else 1.0) for cell in cells]
    return max([*texts, *(_width(cell.below, SMALL) for cell in cells)]) + 2 * GAP


def _blocks(widths: Sequence[float], room: float) -> list[list[int]]:
    """Which columns, counted from 1, stand together; in as few blocks as fit, of like sizes."""
    for count in range(1, len(widths) + 1):
        size = -(-len(widths) // count)
        blocks = [
            list(range(k + 1, min(k + size, len(widths)) + 1)) for k in range(0, len(widths), size)
        ]
        if all(sum(widths[k - 1] for k in block) <= room for block in blocks):
            return blocks
    return [[k + 1] for k in range(len(widths))]


def _tabular(
    head: Sequence[str],
    rows: Sequence[Sequence[LatexCell]],
    columns: Sequence[int],
    names: float,
    width: float,
) -> str:
    heads = [LINE.join(latex_text(line) for line in _heads(head[k])) for k in columns]
    stacked = [rf"\shortstack[r]{{{text}}}" for text in heads]
    layout = rf"@{{}}l{'r' * len(columns)}@{{}}"
    lines = [rf"\noindent\begin{{tabular}}{{{layout}}}", r"\toprule"]
    lines += [" & ".join([latex_text(head[0]), *stacked]) + r" \\", r"\midrule"]
    for row in rows:
        name = [latex_text(line) for line in _name(row[0].text, names)]
        name[0] = re.sub(r"^(?=\[)", "{}", name[0])  # no argument of the line before
        if len(row) < len(head):
            room = width - names - 2 * GAP
            over = rf"\multicolumn{{{len(columns)}}}{{p{{{room:.0f}pt}}@{{}}}}"
            whole = rf"\shortstack[l]{{{LINE.join(name)}}}"
            lines.append(rf"{whole} & {over}{{\raggedright {latex_text(row[1].text)}}} \\")
            continue
        cells = [row[k] for k in columns]
        texts = [latex_text(cell.text) for cell in cells]
        bold = [
            rf"\textbf{{{text}}}" if cell.bold else text
            for text, cell in zip(texts, cells, strict=True)
        ]
        stack = [bold]
        if any(cell.below for cell in cells):
            stack.append([rf"\scriptsize {latex_text(cell.below)}" for cell in cells])
        for number in range(max(len(stack), len(name))):
            left = name[number] if number < len(name) else ""
            right = stack[number] if number < len(stack) else [""] * len(cells)
            lines.append(" & ".join([left, *right]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])
