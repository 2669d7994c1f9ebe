"""Tables of studies by hand."""

import pandas as pd
import pytest

from zfall.studies.tables import as_frame, study_table

FIGURES = {
    "i50_mean": ("mean I50", 3),
    "control_falls": ("falls", 1),
    "frames_per_s": ("frames/s", 0),
}


def lines(**values: list[float]) -> pd.DataFrame:
    count = len(next(iter(values.values())))
    rest = {figure: [1.0] * count for figure in FIGURES}
    return pd.DataFrame({"seed": range(count)} | rest | values)


@pytest.fixture
def table():
    base = lines(i50_mean=[0.50, 0.60, 0.40], frames_per_s=[100.0, 110.0, 120.0])
    better = lines(i50_mean=[0.55, 0.66, 0.44], frames_per_s=[50.0, 60.0, 70.0])
    return study_table({"base": base, "better": better, "not run": lines(seed=[])}, FIGURES)


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
    cell = study_table({"base": base, "other": other}, FIGURES)["other"]["i50_mean"]
    assert cell.difference == pytest.approx((0.0, -0.1, 0.1))


def test_a_difference_that_may_be_zero_is_not_distinct():
    base, other = lines(i50_mean=[0.5, 0.6]), lines(i50_mean=[0.55, 0.55])
    cell = study_table({"base": base, "other": other}, FIGURES)["other"]["i50_mean"]
    assert cell.difference[0] == pytest.approx(0.0)
    assert not cell.distinct


def test_seeds_that_only_one_has_are_left_out_of_the_difference():
    base, other = lines(i50_mean=[0.5, 0.6, 0.9]), lines(i50_mean=[0.6, 0.7])
    cell = study_table({"base": base, "other": other}, FIGURES)["other"]["i50_mean"]
    assert cell.difference[0] == pytest.approx(0.1)


def test_a_figure_that_could_not_be_counted_is_left_out_of_the_mean():
    base, other = lines(i50_mean=[0.5, 0.9]), lines(i50_mean=[float("nan"), 0.7])
    cell = study_table({"base": base, "other": other}, FIGURES)["other"]["i50_mean"]
    assert (cell.mean, cell.seeds) == (0.7, 1)
    assert cell.difference is None  # one pair says nothing


def test_an_empty_table_has_its_columns():
    assert list(as_frame({}))[:2] == ["row", "figure"]


def test_a_frame_has_a_line_for_each_row_and_figure(table):
    frame = as_frame(table).set_index(["row", "figure"])
    assert len(frame) == 2 * len(FIGURES)
    assert frame.loc[("better", "i50_mean"), "difference"] == pytest.approx(0.05)
