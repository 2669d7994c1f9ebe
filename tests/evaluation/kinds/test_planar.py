"""The figures of a planar battery for a study, by hand."""

import pandas as pd
import pytest

from zfall.evaluation.definitions import load_battery
from zfall.evaluation.kinds.planar import Planar


def test_a_row_of_a_study_by_hand():
    """Two directions, two sizes: of I = 0.2 both are recovered from, of 0.4 one."""
    trials = pd.DataFrame(
        {
            "direction_rad": [0.0, 1.0, 0.0, 1.0, 0.0, 1.0],
            "impulse": [0.0, 0.0, 0.2, 0.2, 0.4, 0.4],
            "force_n": 1.0,
            "seed": 0,
            "recovered": [True, False, True, True, True, False],
            "fell": [False, True, False, False, False, True],
            "target_smoothness": [0.002, 0.004, 9.0, 9.0, 9.0, 9.0],  # of the control arm alone
            "joint_torque_rms": [9.0, 9.0, 0.2, 0.4, 9.0, 9.0],  # of the smallest push alone
        }
    )
    row = Planar().study_row(load_battery("planar"), trials, "0.4")
    assert row == pytest.approx(
        {
            "i50_mean": 0.3,
            "i50_min": 0.2,
            "success": 0.5,
            "target_smoothness": 3.0,
            "joint_torque_rms": 0.3,
            "control_falls": 1,
        }
    )
    assert set(Planar.study_figures) - set(row) == {"frames_per_s"}  # of the training


def test_pose_hold_runs_behind_a_policy_with_few_starts():
    kind = Planar()
    assert kind.background(load_battery("planar")).starts == 5
    assert kind.background(load_battery("planar", starts=2)).starts == 2
