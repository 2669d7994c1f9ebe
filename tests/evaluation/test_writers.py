"""Summaries in JSON, tables in csv and Markdown."""

import json
import math

import pandas as pd
import pytest

from zfall.evaluation.writers import markdown, write_summary, write_table


def test_what_is_not_a_number_is_null_however_deep(tmp_path):
    write_summary(tmp_path, {"a": math.nan, "b": [1.0, math.nan], "c": {"d": math.nan, "e": "NaN"}})

    def refuse(word: str) -> None:
        pytest.fail(f"{word} is no JSON")

    read = json.loads((tmp_path / "summary.json").read_text(), parse_constant=refuse)
    assert read == {"a": None, "b": [1.0, None], "c": {"d": None, "e": "NaN"}}


def test_a_table_is_written_for_programs_and_with_three_digits_for_readers(tmp_path):
    rows = pd.DataFrame({"run": ["a", "b"], "share": [0.123456, 2.0], "n": [3, 4]})
    assert write_table(tmp_path, "shares", rows) == ["shares.csv", "shares.md", "shares.tex"]
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "shares.csv"), rows)
    text = (tmp_path / "shares.md").read_text()
    assert text == markdown(rows)
    assert text.splitlines() == [
        "| run | share | n |", "| --- | --- | --- |", "| a | 0.123 | 3 |", "| b | 2 | 4 |"
    ]  # fmt: skip
