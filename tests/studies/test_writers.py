"""Files of a study by hand."""

from zfall.studies.tables import Cell
from zfall.studies.writers import as_latex, as_markdown

FIGURES = {"i50_mean": ("mean I50", 3), "control_falls": ("falls", 1)}
FALLS = Cell(1.0, 1.0, 1.0, 3, None)
ROWS = {
    "base": {"i50_mean": Cell(0.5, 0.4, 0.6, 3, None), "control_falls": FALLS},
    "better": {
        "i50_mean": Cell(0.55, 0.44, 0.66, 3, (0.05, 0.04, 0.06)),
        "control_falls": FALLS,
    },
    "100 % _as": {
        "i50_mean": Cell(0.5, 0.5, 0.5, 1, (0.00004, 0.00002, 0.00006)),
        "control_falls": FALLS,
    },
}
MISSING = {"broken, seed 0": "failed: no_such_key"}


def test_markdown_shows_what_is_bold_and_what_is_missing():
    text = as_markdown(ROWS, MISSING, FIGURES)
    assert "0.550 [0.440, 0.660]; **+0.050 [+0.040, +0.060]**" in text
    assert "| broken, seed 0 | failed: no_such_key |" in text
    assert len({line.count("|") for line in text.splitlines()}) == 1


def test_one_seed_has_no_interval_and_a_difference_of_no_shown_size_is_not_bold():
    assert "| 0.500; +0.000 [+0.000, +0.000] |" in as_markdown(ROWS, {}, FIGURES)


def test_latex_escapes_what_latex_reads():
    latex = as_latex(ROWS, MISSING, FIGURES)
    assert r"\textbf{+0.050 [+0.040, +0.060]}" in latex
    assert r"no\_such\_key" in latex
    assert r"100 \% \_as" in latex
    assert latex.count(r"\\") == 1 + 3 + 1
