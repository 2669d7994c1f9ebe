"""Tables of studies by hand."""

import pandas as pd
import pytest

from zfall.studies.tables import (
    KNEEL,
    PLANAR,
    as_frame,
    as_latex,
    as_markdown,
    kneel_figures,
    study_table,
)


def lines(**values: list[float]) -> pd.DataFrame:
    count = len(next(iter(values.values())))
    rest = {figure: [1.0] * count for figure in PLANAR}
    return pd.DataFrame({"seed": range(count)} | rest | values)


@pytest.fixture
def table():
    base = lines(i50_mean=[0.50, 0.60, 0.40], frames_per_s=[100.0, 110.0, 120.0])
    better = lines(i50_mean=[0.55, 0.66, 0.44], frames_per_s=[50.0, 60.0, 70.0])
    return study_table({"base": base, "better": better, "not run": lines(seed=[])}, PLANAR)


def test_differences_are_paired_by_seed(table):
    """Each seed gains 0.04 to 0.06, although the rows overlap: only pairs show it."""
    cell = table["better"]["i50_mean"]
    assert cell.mean == pytest.approx(0.55)
    assert cell.difference[0] == pytest.approx(0.05)
    assert cell.difference[1] >= 0.04 - 1e-9
    assert cell.difference[2] <= 0.06 + 1e-9
    assert cell.distinct
    assert cell.low < table["base"]["i50_mean"].high


def test_the_first_row_and_speed_have_no_difference(table):
    assert table["base"]["i50_mean"].difference is None
    assert table["better"]["frames_per_s"].difference is None
    assert "not run" not in table


def test_pairs_are_found_by_seed_in_whatever_order():
    """Seed 2 gains 0.1 and seed 1 loses 0.1; seed 0 of the other one failed."""
    base = lines(i50_mean=[0.5, 0.6, 0.9])
    other = lines(i50_mean=[1.0, 0.5]).assign(seed=[2, 1])
    cell = study_table({"base": base, "other": other}, PLANAR)["other"]["i50_mean"]
    assert cell.difference == pytest.approx((0.0, -0.1, 0.1))


def test_a_difference_that_may_be_zero_is_not_distinct():
    base, other = lines(i50_mean=[0.5, 0.6]), lines(i50_mean=[0.55, 0.55])
    cell = study_table({"base": base, "other": other}, PLANAR)["other"]["i50_mean"]
    assert cell.difference[0] == pytest.approx(0.0)
    assert not cell.distinct


def test_seeds_that_only_one_has_are_left_out_of_the_difference():
    base, other = lines(i50_mean=[0.5, 0.6, 0.9]), lines(i50_mean=[0.6, 0.7])
    cell = study_table({"base": base, "other": other}, PLANAR)["other"]["i50_mean"]
    assert cell.difference[0] == pytest.approx(0.1)


def test_texts_show_what_is_bold_and_what_is_missing(table):
    missing = {"broken, seed 0": "failed: no_such_key"}
    text = as_markdown(table, missing, PLANAR)
    assert "0.550 [0.440, 0.660]; **+0.050 [+0.040, +0.060]**" in text
    assert "| broken, seed 0 | failed: no_such_key |" in text
    latex = as_latex(table, missing, PLANAR)
    assert r"\textbf{+0.050 [+0.040, +0.060]}" in latex
    assert r"no\_such\_key" in latex
    assert latex.count(r"\\") == 1 + 2 + 1
    frame = as_frame(table).set_index(["row", "figure"])
    assert frame.loc[("better", "i50_mean"), "difference"] == pytest.approx(0.05)


def test_kneels_are_counted_by_hand():
    """Of the list two small pushes and a large one; of the grid three falls up to 1.5, two beyond."""
    trials = pd.DataFrame(
        [  # listed, I, recovered, kneeled, fell, force on torso, on head, acceleration
            (False, 0.0, True, False, True, 0.0, 0.0, 5.0),  # no push: not among the falls
            (True, 0.41, True, False, False, 0.0, 0.0, 9.0),
            (True, 0.51, False, True, True, 0.0, 0.0, 100.0),
            (True, 1.83, False, False, True, 0.0, 999.0, 999.0),
            (False, 0.5, True, False, False, 0.0, 0.0, 20.0),  # of the grid: not one of the small
            (False, 1.0, True, False, False, 0.0, 0.0, 70.0),  # no fall
            (False, 1.0, False, True, True, 0.0, 0.0, 100.0),
            (False, 1.25, False, True, True, 50.0, 20.0, 150.0),
            (False, 1.5, False, False, True, 0.0, 0.0, 150.0),
            (False, 1.75, False, False, True, 0.0, 0.0, 200.0),
            (False, 2.0, False, True, True, 350.0, 400.0, 300.0),
        ],
        columns=[
            *("listed", "impulse", "recovered", "kneeled", "fell"),
            *("peak_contact_force/torso", "peak_contact_force/head", "peak_base_acceleration"),
        ],
    )
    figures = kneel_figures(trials)
    assert figures == pytest.approx(
        {
            "recovered": 1 / 2,
            "kneeled": 2 / 3,
            "clean": 1 / 2,
            "untouched": 2 / 3,
            "kneeled_beyond": 1 / 2,
            "base_acceleration": 900 / 5,
            "torso_head_force": (50 + 400) / 5,
            "control_falls": 1,
        }
    )
    assert set(figures) == set(KNEEL)
    none = kneel_figures(trials.assign(kneeled=False))
    assert none["kneeled"] == 0.0
    assert none["clean"] != none["clean"]  # there is no kneel to be clean


def test_a_figure_that_could_not_be_counted_is_left_out_of_the_mean():
    rest = {figure: [1.0, 1.0] for figure in KNEEL}
    base = pd.DataFrame({"seed": [0, 1]} | rest | {"clean": [0.5, 0.9]})
    other = pd.DataFrame({"seed": [0, 1]} | rest | {"clean": [float("nan"), 0.7]})
    table = study_table({"base": base, "other": other}, KNEEL)
    assert table["other"]["clean"].mean == 0.7
    assert table["other"]["clean"].difference is None  # one pair says nothing
    assert "| 0.700 |" in as_markdown(table, {}, KNEEL)  # one seed has no interval
