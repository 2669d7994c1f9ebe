"""The page holds what it shows."""

import json
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

from zfall.evaluation.curves import panels
from zfall.evaluation.lost_trials import lost_trials
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

    def handle_endtag(self, tag):
        self.text += " " if tag in ("dt", "td") else ""


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
    shutil.copy(tmp_path / "plots" / "learning_curves.png", battery / "success_map.png")
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


def test_long_heads_of_a_table_may_break_so_that_more_columns_fit(folder):
    rows = pd.DataFrame({"run_name": ["a_b"], "peak_servo_temperature": [1.0]})
    rows.to_csv(folder / "evaluation" / "planar" / "rest.csv", index=False)
    page = write_report(folder).read_text()
    assert "<th>peak_<wbr>servo_<wbr>temperature</th>" in page
    assert "<td>a_b</td>" in page


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
    assert "-m recipes.train name=steady experiment=quickstart</code></dd>" in page


def text_of(folder):
    page = Page()
    page.feed(write_report(folder).read_text())
    return " ".join(page.text.split())


def test_a_page_says_of_which_code_a_run_and_its_battery_are(folder):
    assert "trained with a version that was not recorded" in text_of(folder)
    found = {"zfall": "0.2.0", "commit": "0123abc-dirty"}
    (folder / ".hydra" / "versions.json").write_text(json.dumps(found))
    summary = SUMMARY | {"versions": {"zfall": "0.3.0", "commit": "4567def"}}
    (folder / "evaluation" / "planar" / "summary.json").write_text(json.dumps(summary))
    text = text_of(folder)
    assert "trained with zfall 0.2.0, commit 0123abc-dirty" in text
    assert "Run with zfall 0.3.0, commit 4567def." in text


TRIALS = pd.DataFrame(
    {
        "trial": [0, 1, 2, 3, 4],
        "direction_rad": [0.0, 0.0, np.pi / 2, 0.0, 0.0],
        "impulse": [0.0, 0.4, 0.2, 0.2, 0.2],
        "body": "torso",
        "recovered": [True, False, False, True, False],
        "fell": [False, True, True, False, False],
        "kneeled": [False, True, False, False, False],
        "time_to_fall_s": [np.nan, 0.5, 0.75, np.nan, np.nan],
    }
)


def test_trials_lost_to_the_smallest_pushes_come_first(folder):
    """Of equal pushes the one that fell sooner; what neither fell nor recovered stands bent."""
    rows = lost_trials(TRIALS)
    assert rows["trial"].tolist() == [2, 4, 1]
    assert rows["outcome"].tolist() == ["fell", "stands bent", "kneeled"]
    assert rows["toward [deg]"].tolist() == [90.0, 0.0, 0.0]
    assert lost_trials(TRIALS, 1)["trial"].tolist() == [2]


def test_each_lost_trial_has_its_line_if_it_is_known(folder):
    battery = folder / "evaluation" / "planar"
    TRIALS.to_csv(battery / "trials.csv", index=False)
    assert "recipes.evaluate run=" in text_of(folder)  # nothing was changed of the battery
    other = battery.with_name("planar_starts-2")
    battery.rename(other)
    assert "trial=2 video=true" not in text_of(folder)
    given = ["battery=planar", "change=[transforms.action.scale=0.5]"]
    (other / "summary.json").write_text(json.dumps(SUMMARY | {"given": given}))
    line = "battery=planar 'change=[transforms.action.scale=0.5]' trial=2 video=true"
    assert line in text_of(folder)
    TRIALS.assign(round=1).to_csv(other / "trials.csv", index=False)
    assert "trial=2" not in text_of(folder)  # a bisection has no trials by themselves


def test_curves_carry_their_values_and_need_nothing_from_elsewhere(folder):
    """At the end of a straight line from 0 to 4 million the mean is nearly that."""
    page = write_report(folder).read_text()
    frames = json.loads(re.findall(r'data-frames="([^"]*)"', page)[0])
    assert (frames[0], frames[-1]) == (0.0, 4.0)
    values = [json.loads(text) for text in re.findall(r'data-values="([^"]*)"', page)]
    assert len(values) == 4  # return, length, divergence, a reward term
    for each in values:
        assert len(each) == len(frames)
        assert each[len(each) // 2] == pytest.approx(2e6, rel=0.02)
    assert "running mean" in page
    assert "http" not in page.replace("http-equiv", "")


def test_a_curve_with_gaps_is_drawn_in_pieces():
    rows = pd.DataFrame(
        {"frames": np.arange(10.0), "episode_return": [1.0] * 3 + [np.nan] * 3 + [2.0] * 4}
    )
    (panel,) = panels({"a": rows, "b": rows})
    assert [curve.name for curve in panel.curves] == ["a", "b"]
    assert panel.curves[0].faint.count("M") == 2
    assert len({(curve.color, curve.dashes) for curve in panel.curves}) == 2
