"""The page holds what it shows."""

import json
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

from zfall.evaluation.plots import learning_curves
from zfall.evaluation.report import write_report


class Page(HTMLParser):
    def __init__(self):
        super().__init__()
        self.sources, self.text = [], ""

    def handle_starttag(self, tag, attrs):
        self.sources += [value for key, value in attrs if key in ("src", "href")]

    def handle_data(self, data):
        self.text += data


SUMMARY = {
    "battery": "planar", "battery_version": 1, "n": 40, "seed": 0, "control_falls": 1,
    "control_n": 20, "i50_mean": 0.512, "i50_min": 0.4, "i90_mean": 0.3, "i90_min": 0.2,
    "success": {"0.4": 0.875}, "success_low": {"0.4": 0.81}, "success_high": {"0.4": 0.92},
    "force_n": {"0.4": 19.7}, "definition": {"starts": 20},
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    columns = ("frames", "episode_return", "episode_seconds", "terminated", "kl", "reward/upright")
    metrics = pd.DataFrame({name: np.linspace(0, 4e6, 20) for name in columns})
    metrics.to_csv(tmp_path / "metrics.csv", index=False)
    (tmp_path / "plots").mkdir()
    learning_curves(metrics, tmp_path / "plots" / "learning_curves.png")
    battery = tmp_path / "evaluation" / "planar"
    battery.mkdir(parents=True)
    (battery / "summary.json").write_text(json.dumps(SUMMARY))
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text("seed: 7\nnote: <script>alert(1)</script>\n")
    (tmp_path / ".hydra" / "overrides.yaml").write_text("- seed=7\n- caps=atalante\n")
    return tmp_path


def test_page_is_self_contained_and_says_what_was_measured(folder):
    page = Page()
    page.feed(write_report(folder).read_text())
    assert page.sources
    assert all(source.startswith("data:") for source in page.sources)
    for text in ("87.5 %", "81.0 to 92.0 %", "mean 0.512", "1 of 20", "4.00 million control steps",
                 "python -m recipes.train seed=7 caps=atalante", "torchrl 0.14"):  # fmt: skip
        assert text in page.text, text


def test_what_stands_in_a_config_is_text(folder):
    assert "<script>alert" not in write_report(folder).read_text()


def test_long_tables_are_folded(folder):
    assert "rows</summary>" not in write_report(folder).read_text()
    rows = pd.DataFrame({"largest": np.linspace(0, 1, 96)})
    rows.to_csv(folder / "evaluation" / "planar" / "envelope.csv", index=False)
    assert "<summary>96 rows</summary>" in write_report(folder).read_text()


def test_overrides_of_a_run_are_shown_as_they_stand(folder, monkeypatch):
    monkeypatch.setenv("SECRET", "hush")
    (folder / ".hydra").mkdir(exist_ok=True)
    (folder / ".hydra" / "overrides.yaml").write_text("- name=${oc.env:SECRET}\n")
    page = write_report(folder).read_text()
    assert "hush" not in page
    assert "${oc.env:SECRET}" in page


DAMAGES = {
    "metrics.csv": ["", "\x00\x01", "frames,kl\n1,2\n1,2,3,4\n", "update\n1\n", "frames\nmany\n"],
    "timing.csv": ["", "collect_s\n1.0\n", "collect_s,learn_s\na,b\n"],
    "evaluation/planar/summary.json": [
        "", "[]", "3", "{", "[" * 100_000, '{"n": 3}', "\udcff",
        json.dumps(SUMMARY | {"i50_mean": "much"}),
        json.dumps(SUMMARY | {"force_n": {"0.6": 30.0}}),
        json.dumps(SUMMARY | {"success": [0.5]}),
    ],
    "evaluation/planar/by_size.csv": ["", '"'],
    "comparison.csv": [""],
    ".hydra/config.yaml": ["\udcff"],
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_file_is_named_in_one_line_and_the_page_before_stays(folder, name):
    write_report(folder)
    page = (folder / "report.html").read_bytes()
    for content in DAMAGES[name]:
        (folder / name).write_bytes(content.encode(errors="surrogateescape"))
        with pytest.raises(ValueError, match=f"{name} must be") as caught:
            write_report(folder)
        assert "\n" not in str(caught.value)
        assert "take another copy, or remove it" in str(caught.value)
        assert (folder / "report.html").read_bytes() == page


def test_a_comparison_without_its_summary_or_with_an_empty_one_is_refused(folder):
    (folder / "comparison.csv").write_text("run,success\none,0.5\n")
    (folder / "summary.json").write_text("{}")
    with pytest.raises(ValueError, match="summary.json must be as it was written"):
        write_report(folder)


def test_a_page_is_named_and_gives_its_command_as_code(folder):
    (folder / ".hydra" / "overrides.yaml").write_text("- name=steady\n- experiment=quickstart\n")
    page = write_report(folder).read_text()
    assert f"<h1>steady, quickstart, {folder.name}</h1>" in page
    assert "-m recipes.train name=steady experiment=quickstart</code></pre>" in page
