"""Files of a study by hand."""

from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from tests.studies.conftest import TINY, some_test, write
from zfall.studies.plan import Run
from zfall.studies.store import Store
from zfall.studies.tables import Cell, Table, as_frame
from zfall.studies.writers import (
    as_latex,
    as_markdown,
    check_keeps_all,
    sheet_of,
    write_tables,
)

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
    assert r"better & \textbf{0.550} & 1.0 \\" in latex
    assert r" & \scriptsize [0.440, 0.660] & \scriptsize [1.0, 1.0] \\" in latex
    assert r"base & 0.500 &" in latex
    assert r"no\_such\_key" in latex
    assert r"100 \% \_as" in latex
    assert latex.count(r"\textbf") == 1


def test_a_printed_table_has_a_star_where_latex_has_bold_and_says_what_is_missing():
    table = Table("calm", ROWS, MISSING)
    rows = sheet_of(table, FIGURES, title="tiny").rows
    assert rows["mean I50"].tolist() == [
        "0.500\n[0.400, 0.600]", "0.550*\n[0.440, 0.660]", "0.500", "failed: no_such_key"
    ]  # fmt: skip


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


@pytest.mark.parametrize("what", ["a table", "a figure"])
def test_an_error_while_files_are_written_leaves_all_of_them_as_they_were(
    tmp_path, monkeypatch, request, what
):
    store = Store(tmp_path / "results", tmp_path / "runs")
    runs = [Run("none", seed, None, None, (), (some_test(seed=seed),)) for seed in (0, 1)]
    study = SimpleNamespace(name="tiny", plan=runs, battery=TINY["battery"])
    write(store, runs[0].tests[0])
    _, paths = write_tables(study, store)
    assert sorted(path.suffix for path in paths) == [".csv", ".md", ".pdf", ".png", ".tex"]
    before = {path: path.read_bytes() for path in paths}
    write(store, runs[1].tests[0])
    if what == "a table":
        request.getfixturevalue("full_disk")
    else:
        monkeypatch.setattr("matplotlib.figure.Figure.savefig", cannot_draw)
    with pytest.raises(OSError, match="No space left"):
        write_tables(study, store)
    assert {path: path.read_bytes() for path in paths} == before
    assert {path for path in store.results.iterdir() if path.is_file()} == set(paths)
    monkeypatch.undo()
    write_tables(study, store)
    assert paths[0].read_bytes() != before[paths[0]]


def cannot_draw(figure: object, path: Path, **options: object) -> None:
    """What a full disk leaves of a figure."""
    path.write_bytes(b"PNG")
    raise OSError("No space left on device")
