"""Trials and pushes of a planar battery, by counts and by hand."""

import numpy as np
import torch

from zfall.evaluation.definitions import load_battery
from zfall.evaluation.plans import plan_pushes, plan_trials
from zfall.robots import ZEROTH01


def test_plan_has_every_cell_and_a_control_arm():
    trials = plan_trials(load_battery("planar"), 4.92, seed=3)
    assert len(trials) == 12 * 20 * 20 + 12 * 20
    counts = trials.groupby(["direction_rad", "impulse"]).size()
    assert (counts == 20).all()
    assert len(counts) == 12 * 21
    assert (trials["impulse"] == 0).sum() == 240
    assert trials["trial"].tolist() == list(range(5040))


def test_force_has_the_impulse_and_heading_of_the_trial():
    trials = plan_trials(load_battery("planar"), 4.92, seed=0)
    force = plan_pushes(load_battery("planar"), trials).force[:, 0]
    size = force.norm(dim=-1).numpy() * 0.1 / 4.92
    np.testing.assert_allclose(size, trials["impulse"], atol=1e-6)
    pushed = trials["impulse"] > 0
    x, y = force[pushed.to_numpy().copy(), :2].numpy().T
    heading = np.arctan2(y, x) - trials["direction_rad"][pushed]
    np.testing.assert_allclose(np.cos(heading), 1.0, atol=1e-6)
    assert force[(trials["direction_rad"] == 0.0).to_numpy().copy()][-1, 0] > 0  # 0 is forward, +x


def test_pushes_may_begin_in_any_physics_step_of_some_seconds():
    """Ten for each of 25 spells of 40 ms: of 960 pushes 38.4 in each, with a deviation of 6.1."""
    battery = load_battery("planar", impulses=[1.0], starts=40, directions=24)
    trials = plan_trials(battery, ZEROTH01.impulse_unit, seed=0)
    planned = plan_pushes(battery, trials)
    later = planned.later(1.0, 0.004, seed=1)
    steps = (later.time - planned.time)[trials["impulse"].to_numpy() > 0] / 0.004
    torch.testing.assert_close(steps, steps.round(), rtol=0, atol=1e-6)
    count = torch.bincount(steps.flatten().round().long() // 10)
    assert len(count) == 25
    assert 38.4 - 4 * 6.1 < int(count.min()) <= int(count.max()) < 38.4 + 4 * 6.1
    assert len(torch.bincount(steps.flatten().round().long() % 10)) == 10  # within a control step
    assert torch.equal(later.force, planned.force)
    assert torch.equal(planned.later(1.0, 0.004, seed=1).time, later.time)
    assert not torch.equal(planned.later(1.0, 0.004, seed=2).time, later.time)
