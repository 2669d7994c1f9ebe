"""The battery ``cycle``: its pushes, and its figures by hand."""

import pandas as pd
import pytest

from zfall.evaluation.definitions import load_battery
from zfall.evaluation.plans import plan_pushes, plan_trials
from zfall.falling.cycle_battery import Cycle, cycle_figures, cycle_table
from zfall.robots import ZEROTH01


def test_pushes_are_level_of_the_size_of_their_episode_and_come_every_ten_seconds():
    battery = load_battery("cycle", starts=40)
    trials = plan_trials(battery, ZEROTH01.impulse_unit, seed=0)
    assert sorted(trials["impulse"].unique()) == [1.0, 1.25, 1.5, 1.75, 2.0]
    pushes = plan_pushes(battery, trials)
    acts = pushes.time.isfinite()
    assert (pushes.force[..., 2] == 0.0).all()
    size = pushes.force.norm(dim=-1) * pushes.duration / ZEROTH01.impulse_unit
    assert size[acts].tolist() == pytest.approx(
        [i for i, row in zip(trials["impulse"], acts, strict=True) for _ in range(int(row.sum()))],
        rel=1e-4,
    )
    # 200 episodes of 59 s: the number of pushes is binomial, 1180 with a deviation of 34.
    assert abs(int(acts.sum()) - 1180) < 4 * 34
    assert (pushes.time[acts] >= 1.0).all()


def test_rates_are_worked_out_by_hand():
    """Two minutes: five falls, of which one is open and three stand; eight pushes met."""
    trials = pd.DataFrame(
        {
            "impulse": [1.0, 2.0],
            "falls": [2.0, 3.0],
            "falls_open": [0.0, 1.0],
            "falls_stood": [2.0, 1.0],
            "pushes_met": [5.0, 3.0],
            "pushes_down": [1.0, 2.0],
            "down_s": [12.0, 30.0],
            "landing_force": [400.0, 900.0],
            "landing_torque": [10.0, 15.0],
            "landing_vulnerable": [1.0, 3.0],
            "rise_force": [200.0, 300.0],
            "fell": True,
            "seed": 0,
        }
    )
    figures = cycle_figures(trials, 60.0)
    assert figures["stood_share"] == pytest.approx(3 / 4)
    assert figures["stood_share_low"] < 0.75 < figures["stood_share_high"]
    assert figures["pushes_met_per_minute"] == pytest.approx(8 / 2)
    assert figures["down_share"] == pytest.approx(42 / 120)
    assert figures["landing_force"] == pytest.approx(1300 / 5)
    assert figures["landing_vulnerable"] == pytest.approx(4 / 5)
    summary = Cycle().summary(load_battery("cycle"), trials)
    assert summary["cycle"]["2"]["stood_share"] == pytest.approx(1 / 2)
    assert cycle_table(summary)["I"].tolist() == ["all", "1", "2"]
    assert Cycle().study_row(load_battery("cycle"), trials, "")["landing_force"] == 260.0


def test_what_is_the_same_in_every_fall_has_no_width_however_many_there_are():
    falls = [1.0, 7.0, 2.0, 4.0]
    trials = pd.DataFrame({"falls": falls, "landing_torque": [5.0 * n for n in falls]})
    others = ("falls_open", "falls_stood", "pushes_met", "pushes_down", "down_s", "landing_force")
    trials = trials.assign(**dict.fromkeys((*others, "landing_vulnerable", "rise_force"), 0.0))
    figures = cycle_figures(trials, 60.0)
    ends = figures["landing_torque_low"], figures["landing_torque_high"]
    assert ends == pytest.approx((5.0, 5.0))


def test_who_never_falls_has_no_figure_of_falls():
    names = ("falls", "falls_open", "falls_stood", "pushes_down", "down_s", "landing_force",
             "landing_torque", "landing_vulnerable", "rise_force")  # fmt: skip
    zero = {name: [0.0] for name in names}
    figures = cycle_figures(pd.DataFrame(zero | {"pushes_met": [6.0]}), 60.0)
    assert figures["stood_share"] is None
    assert figures["landing_force_high"] is None
    assert figures["pushes_met_per_minute"] == 6.0
    row = cycle_table({"cycle": {"all": figures}}).iloc[0]
    assert row["stood_share"] == "-"
