"""Files of a study by hand."""

import pandas as pd
import pytest

from zfall.studies.tables import Cell, as_frame
from zfall.studies.writers import as_latex, as_markdown, check_keeps_all

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


def test_a_table_keeps_its_runs(tmp_path):
    """Also one of an earlier version, which does not say how many there are."""
    path, whole = tmp_path / "tiny.csv", as_frame(ROWS)
    fewer = whole[whole["row"] != "better"]
    check_keeps_all(path, fewer, str)  # there is none yet
    for before in (whole, whole.drop(columns="seeds")):
        before.to_csv(path, index=False)
        check_keeps_all(path, whole, str)
        with pytest.raises(ValueError, match="tiny.csv must keep .*better: why.*force=true"):
            check_keeps_all(path, fewer, lambda row: f"why {row}")
    whole.assign(seeds=3).to_csv(path, index=False)
    with pytest.raises(ValueError, match="must keep its 9 finished runs, 3 would be lost"):
        check_keeps_all(path, whole.assign(seeds=2), str)


def test_runs_are_counted_by_row_and_world(tmp_path):
    path, frame = tmp_path / "tiny.csv", as_frame(ROWS)
    both = pd.concat([frame.assign(test="calm"), frame.assign(test="rough")])
    both.to_csv(path, index=False)
    with pytest.raises(ValueError, match="base \\(rough\\)"):
        check_keeps_all(path, frame.assign(test="calm"), str)
