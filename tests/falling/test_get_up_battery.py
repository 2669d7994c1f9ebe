"""The battery ``get_up``: where its trials begin, and its figures by hand."""

import numpy as np
import pandas as pd
import pytest
import torch

from zfall.evaluation.battery import run_battery
from zfall.evaluation.candidate import load_candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.plans import plan_trials
from zfall.falling.get_up_battery import GetUp, get_up_table
from zfall.falling.lying import POSTURES, posture_of
from zfall.robots import ZEROTH01


def test_there_is_a_trial_for_each_posture_and_start_and_nothing_pushes():
    trials = plan_trials(load_battery("get_up", starts=3), ZEROTH01.impulse_unit, seed=0)
    assert trials["start"].tolist() == [name for name in POSTURES for _ in range(3)]
    assert (trials["impulse"] == 0.0).all()


def test_shares_and_intervals_are_counted_by_hand():
    """Of four kneels two stand within 5 s, three within 8 s; one of these lies again at the end.

    Wilson's interval of 2 in 4: (2 + z^2 / 2 -+ z sqrt(1 + z^2 / 4)) / (4 + z^2), z = 1.96.
    """
    trials = pd.DataFrame(
        {
            "start": ["kneel"] * 4 + ["belly"] * 2,
            "stood_s": [3.0, 5.0, 7.0, np.nan, 4.0, 9.0],
            "stood": [True, True, False, False, True, True],
            "impulse": 0.0,
            "fell": True,
            "seed": 0,
            "peak_contact_force": [100.0, 200.0, 300.0, 400.0, 50.0, 70.0],
            "peak_joint_torque": 5.0,
        }
    )
    others = trials.iloc[[4]].assign(start="back"), trials.iloc[[4]].assign(start="left")
    trials = pd.concat([trials, *others, trials.iloc[[4]].assign(start="right")])
    summary = GetUp().summary(load_battery("get_up"), trials)
    kneel = summary["get_up"]["kneel"]
    assert (kneel["n"], kneel["within_5"], kneel["within_8"]) == (4, 0.5, 0.75)
    assert kneel["stands_at_the_end"] == 0.5
    z = 1.959964
    low = (2 + z**2 / 2 - z * (1 + z**2 / 4) ** 0.5) / (4 + z**2)
    assert kneel["within_5_low"] == pytest.approx(low, abs=1e-6)
    assert kneel["within_5_high"] == pytest.approx(1 - low, abs=1e-6)
    assert kneel["median_s"] == 5.0
    assert kneel["peak_contact_force_mean"] == 250.0
    assert summary["get_up"]["lying"]["n"] == 5
    assert summary["get_up"]["lying"]["within_8"] == pytest.approx(4 / 5)
    table = get_up_table(summary).set_index("start")
    assert table.loc["kneel", "within_8"].startswith("75 %")
    row = GetUp().study_row(load_battery("get_up"), trials, "")
    assert row == {"kneel_5": 0.5, "kneel_8": 0.75, "lying_5": 0.8, "lying_8": 0.8}


def test_robots_begin_in_the_posture_and_those_that_hold_still_stay_down():
    """``pose_hold`` in the battery's world: nobody stands, and the first touch is at once."""
    battery = load_battery("get_up", starts=1, end_time=0.4)
    tested = load_candidate("pose_hold")
    seen = []

    def watch(base, td):
        seen.append(posture_of(td["projected_gravity"]))

    trials = run_battery(battery, tested.env_cfg, tested.actor, num_envs=64, watch=watch)
    assert [POSTURES[i] for i in seen[0][: len(trials)]] == trials["start"].tolist()
    assert trials["stood_s"].isna().all()
    assert not trials["stood"].any()
    assert trials["fell"].all()
    assert (trials["time_to_fall_s"] < 0.05).all()


@pytest.mark.slow
def test_the_movements_get_up_from_the_belly():
    battery = load_battery("get_up", starts=1)
    tested = load_candidate("scripted_rise", task="push_to_stand")
    belly = POSTURES.index("belly")
    trials = run_battery(battery, tested.env_cfg, tested.actor, num_envs=64, only=[belly])
    assert trials["stood"].all()
    assert torch.tensor(trials["stood_s"].to_numpy()).max() < 8.0
