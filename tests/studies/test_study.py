"""Studies from Python."""

import inspect
import textwrap

import pandas as pd
import pytest
from rich.console import Console

from zfall.studies import Study

QUIET = Console(quiet=True)


@pytest.mark.long
def test_the_documented_lines_run_as_written(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    doc = inspect.getdoc(Study) or ""
    example = textwrap.dedent(doc.split("::\n", 1)[1].split("\nThe yaml files", 1)[0])
    names: dict = {}
    exec(example, names)
    table = names["table"]
    assert list(table["row"].unique()) == ["none", "loss"]
    pd.testing.assert_frame_equal(table, pd.read_csv(tmp_path / "results" / "symmetry.csv"))
    changed = table[(table["row"] == "loss") & (table["figure"] == "i50_mean")]
    assert changed["difference"].notna().all()


def test_results_are_made_once_and_tables_from_results_alone(tiny, tmp_path):
    study = tiny(rows={"plain": []}, seeds=[0])
    folders = {"results": tmp_path / "results", "runs": tmp_path / "runs"}
    submitted: list = []
    before = study.run(**folders, rebuild=True)
    assert not len(before)
    assert "| plain, seed 0 | not run |" in (tmp_path / "results" / "tiny.md").read_text()
    study.run(**folders, console=QUIET, submit=submitted.extend)
    assert submitted == [0]
    first = study.run(**folders, console=QUIET)
    again = study.run(**folders, console=QUIET, submit=submitted.extend)
    assert submitted == [0]
    pd.testing.assert_frame_equal(first, again)


def test_an_error_of_one_row_leaves_the_others(tiny, tmp_path):
    study = tiny(rows={"bad": ["env.transforms.push.point=toe"], "good": []}, seeds=[0])
    table = study.run(results=tmp_path / "results", runs=tmp_path / "runs", console=QUIET)
    assert set(table["row"]) == {"good"}
    text = (tmp_path / "results" / "tiny.md").read_text()
    assert "| bad, seed 0 | failed: env.transforms.push: point must be" in text


@pytest.mark.long
def test_two_policies_are_trained_once_and_tested_in_each_world(falls, tmp_path):
    """The one that recovers stands in two rows."""
    table = falls().run(results=tmp_path / "results", runs=tmp_path / "runs", console=QUIET)
    text = (tmp_path / "results" / "falls.md").read_text()
    assert "failed" not in text, text
    assert text.index("Tested: tilt") < text.index("| two |") < text.index("Tested: late")
    assert len(list((tmp_path / "runs").glob("*/checkpoints"))) == 3
    assert set(table["test"]) == {"tilt", "late"}
    assert set(table["row"]) == {"two", "one", "script"}


def test_worlds_are_the_rows_of_a_study_with_one_row(falls, tmp_path):
    rows = {"script": ["experiment=push_to_kneel_recover"]}
    study = falls(rows=rows, tested_with={})
    study.run(results=tmp_path, runs=tmp_path / "runs", rebuild=True)
    text = (tmp_path / "falls.md").read_text()
    assert "| tilt, seed 0 | not run |" in text
    assert "| late, seed 0 | not run |" in text
    assert "Tested:" not in text


@pytest.mark.parametrize("changes", [{"training_size": 0.5}, {"rows": {"none": ["seed=3"]}}])
def test_a_bad_study_leaves_no_files(tiny, changes, tmp_path):
    with pytest.raises(ValueError, match="study."):
        tiny(**changes).run(results=tmp_path / "results", runs=tmp_path / "runs")
    assert not list(tmp_path.iterdir())
