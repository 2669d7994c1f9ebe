"""What is not known, in JSON."""

import json
import math

import pytest

from zfall.evaluation.summaries import write_summary


def test_what_is_not_a_number_is_null_however_deep(tmp_path):
    write_summary(tmp_path, {"a": math.nan, "b": [1.0, math.nan], "c": {"d": math.nan, "e": "NaN"}})

    def refuse(word: str) -> None:
        pytest.fail(f"{word} is no JSON")

    read = json.loads((tmp_path / "summary.json").read_text(), parse_constant=refuse)
    assert read == {"a": None, "b": [1.0, None], "c": {"d": None, "e": "NaN"}}
