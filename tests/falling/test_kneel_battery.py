"""The kind ``Kneel``: its trials, and the figures of a study, by hand."""

from dataclasses import replace

import pandas as pd
import pytest
import torch

from zfall.configs import compose_config
from zfall.evaluation.battery import run_battery
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.plans import plan_pushes, plan_trials
from zfall.falling.kneel_battery import Kneel
from zfall.falling.modes import KNEEL, RECOVER, RISE
from zfall.robots import ZEROTH01


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
    battery = load_battery("kneel")
    figures = Kneel().study_row(battery, trials, "")
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
    assert set(figures) == set(Kneel.study_figures)
    none = Kneel().study_row(battery, trials.assign(kneeled=False), "")
    assert none["kneeled"] == 0.0
    assert none["clean"] != none["clean"]  # there is no kneel to be clean


def test_kneel_tries_the_listed_forces_and_a_grid():
    battery = load_battery("kneel")
    trials = plan_trials(battery, ZEROTH01.impulse_unit, seed=0)
    listed, grid = trials[trials["listed"]], trials[~trials["listed"] & (trials["impulse"] > 0)]
    assert (grid.groupby("impulse").size() == 108).all()
    assert len(listed) == 1000
    force = plan_pushes(battery, listed).force[::100, 0]
    expected = [[20, 0], [-25, 0], [0, 20], [0, -20], [50, 0], [35, 25], [-45, 20], [90, 0],
                [-100, 0], [70, 50]]  # fmt: skip
    torch.testing.assert_close(force[:, :2], torch.tensor(expected).float(), atol=1e-4, rtol=0)
    sizes = listed["impulse"].iloc[::100].to_numpy()
    assert sizes[:4].max() < 0.515  # the numbers the project's own table gives
    assert 0.87 < sizes[4:7].min() < sizes[4:7].max() < 1.02
    assert 1.74 < sizes[7:].min() < sizes[7:].max() < 2.04


def test_on_the_twin_it_is_the_same_battery_in_the_twin_s_hardware():
    later, twin = load_battery("kneel_later"), load_battery("kneel_twin")
    assert twin.world == load_battery("twin").world
    assert replace(twin, name="kneel_later", world=None) == later


def test_in_it_nobody_gets_up_again():
    """Where it has come to rest ``push_to_stand`` rises after 0.04 s, in other batteries."""
    cfg = compose_config(["env=push_to_stand", "num_envs=64"]).env
    few = {"impulses": [1.5], "directions": 4, "starts": 1, "end_time": 5.0}
    seen = []
    for name, own in (("kneel_twin", {"forces": []}), ("twin", {"aftermath": None})):
        modes = set()
        run_battery(
            load_battery(name, **few, **own),
            cfg,
            None,
            watch=lambda base, td, modes=modes: modes.update(td["mode"].argmax(-1).tolist()),
        )
        seen.append(modes)
    assert RISE in seen[1]
    assert seen[0] >= {RECOVER, KNEEL}
    assert RISE not in seen[0]
