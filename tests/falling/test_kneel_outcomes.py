"""Figures of battery kneel, by hand."""

import numpy as np
import pandas as pd
import pytest

from zfall.falling.kneel_outcomes import compare_falls, outcome_table, summarize_kneel


def test_summary_by_hand():
    """Of six pushes of I = 1 two are recovered; three kneels, one of them with the torso down."""
    trials = pd.DataFrame(
        {
            "impulse": [0.0] + [1.0] * 6 + [0.5] * 2,
            "direction_rad": 0.0,
            "force_n": [0.0] + [49.0] * 6 + [20.0] * 2,
            "listed": [False] * 7 + [True] * 2,
            "recovered": [True, True, True, False, False, False, False, True, False],
            "fell": [False, False, False, True, True, True, True, False, True],
            "kneeled": [False, False, False, True, True, True, False, False, False],
            "peak_contact_force/torso": [0.0, 0, 0, 0, 0, 30, 90, 0, 999],
            "peak_contact_force/head": [0.0, 0, 0, 0, 0, 0, 110, 0, 0],
            "peak_base_acceleration": [10.0, 10, 10, 20, 40, 60, 80, 10, 999],
            "impact_energy": 1.0,
            "peak_joint_torque": [0.0] * 3 + [2.0, 3.0, 4.0, 7.0] + [0.0, 99.0],
            "kneel_time_s": 0.5,
            "time_to_fall_s": 0.3,
        }
    )
    summary = summarize_kneel(trials)
    entry = summary["by_impulse"]["1"]
    assert entry["n"] == 6
    assert entry["recovered"] == pytest.approx(2 / 6)
    assert entry["kneeled"] == pytest.approx(3 / 4)
    assert entry["clean"] == pytest.approx(2 / 3)
    assert entry["untouched"] == pytest.approx(2 / 4)
    assert entry["kneeled_low"] < 0.75 < entry["kneeled_high"]
    assert summary["listed"]["(20, 0)"]["recovered"] == 0.5
    assert summary["listed"]["(20, 0)"]["kneeled"] == 0.0
    assert summary["listed"]["(20, 0)"]["clean"] is None  # nothing kneeled
    assert summary["grid_falls"] == 4  # of the grid
    assert summary["grid_falls_peak_base_acceleration_mean"] == 50.0
    assert summary["grid_falls_peak_torso_head_force_mean"] == pytest.approx((30 + 110) / 4)
    assert summary["grid_falls_peak_joint_torque_mean"] == 4.0
    assert entry["peak_base_acceleration"] == 50.0
    assert entry["peak_base_acceleration_low"] is None  # of four there is no interval
    assert summary["listed"]["(20, 0)"]["peak_joint_torque"] == 99.0
    shown = outcome_table(summary).set_index("push")["peak_base_acceleration"]
    assert shown[["I 1", "force [N] (20, 0)"]].tolist() == ["50", "999"]
    many = pd.concat([trials] * 5, ignore_index=True)
    entry = summarize_kneel(many)["by_impulse"]["1"]  # 20 falls, standard error of their mean 5
    assert entry["peak_base_acceleration"] == 50.0
    assert entry["peak_base_acceleration_low"] == pytest.approx(50 - 1.96 * 5, abs=1.0)
    assert entry["peak_base_acceleration_high"] == pytest.approx(50 + 1.96 * 5, abs=1.0)
    lying = trials.assign(time_to_fall_s=-1.0)  # when the push came
    assert summarize_kneel(lying)["by_impulse"]["1"]["peak_base_acceleration"] is None


def test_falls_are_compared_over_the_pushes_after_which_all_fell():
    """Of five pushes of the grid: both fall after three, with peaks of twice and half as much.

    Ten times over, and one more that one of the two met lying on the floor.
    """
    one = pd.DataFrame(
        {
            "impulse": [0.0] + [1.0] * 6,
            "listed": [False] * 6 + [True],
            "recovered": [True, True, False, False, False, False, False],
            "peak_contact_force/torso": [0.0, 0, 0, 20, 40, 60, 999],
            "peak_contact_force/head": [0.0, 0, 0, 0, 90, 0, 0],
            "peak_base_acceleration": [10.0, 10, 10, 20, 40, 60, 999],
            "peak_joint_torque": 2.0,
            "time_to_fall_s": 0.3,
        }
    )
    one = pd.concat([*[one] * 10, one.iloc[3:4]], ignore_index=True)
    two = one.assign(
        recovered=[*[True, True, True, False, False, False, False] * 10, False],
        time_to_fall_s=[*[0.3] * 70, -0.2],
        **{"peak_base_acceleration": 2 * one["peak_base_acceleration"], "peak_joint_torque": 1.0},
    )
    still = one.assign(peak_joint_torque=0.0)
    soft = one.assign(**{f"peak_contact_force/{name}": 0.0 for name in ("torso", "head")})
    soft.loc[[5], "peak_contact_force/head"] = 1.0  # one of its falls
    table = compare_falls({"one": one, "two": two}).set_index("run")
    assert table["falls"].tolist() == [30, 30]
    assert table["peak_base_acceleration"].tolist() == [40.0, 80.0]
    assert table["peak_torso_head_force"].tolist() == pytest.approx([170 / 3] * 2)
    assert table["torso_head_touched"].tolist() == [1.0, 1.0]
    for end in ("low", "high"):  # of every sample of pairs it is the same
        assert table[f"peak_base_acceleration_ratio_{end}"].tolist() == pytest.approx([1.0, 0.5])
        assert table[f"peak_joint_torque_ratio_{end}"].tolist() == pytest.approx([1.0, 2.0])
    compared = compare_falls({"one": one, "still": still}).set_index("run")
    assert np.isnan(compared["peak_joint_torque_ratio_low"]["still"])  # nothing to divide by
    compared = compare_falls({"soft": soft, "one": one}).set_index("run")
    assert compared["torso_head_touched"].tolist() == pytest.approx([1 / 41, 31 / 41])
    low, high = (compared[f"torso_head_touched_ratio_{end}"]["one"] for end in ("low", "high"))
    assert low < 1 / 31 < high  # one fall of 41, where the other has 31
