"""Random pushes against the statistics of what they are drawn from, and those withstood."""

import numpy as np
import pytest
import torch

from zfall.evaluation.battery import run_battery
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.kinds.spherical import withstood
from zfall.evaluation.plans import plan_pushes, plan_trials
from zfall.robots import ZEROTH01

UNIT = ZEROTH01.impulse_unit


@pytest.fixture(scope="module")
def spherical():
    battery = load_battery("spherical")
    trials = plan_trials(battery, UNIT, seed=5)
    return battery, trials, plan_pushes(battery, trials)


def test_random_pushes_come_as_often_as_they_should(spherical):
    """A push, the ticks it acts, then 75 ticks on average until the next."""
    battery, trials, pushes = spherical
    for duration in battery.durations:
        rows = (trials["duration_s"] == duration).to_numpy()
        count = torch.isfinite(pushes.time[torch.tensor(rows)]).sum(1).double()
        ticks = np.ceil(duration / 0.04 - 1e-9)
        expected = 59.0 / (0.04 * (ticks - 1) + 3.0)  # from 1 s to 60 s
        error = count.std() / len(count) ** 0.5
        assert abs(count.mean() - expected) < 4 * error + 0.5  # half a push at the open end
        assert count.std() == pytest.approx(expected**0.5, rel=0.15)


def test_random_pushes_neither_overlap_nor_leave_the_ticks(spherical):
    _, trials, pushes = spherical
    gap = pushes.time.diff(dim=1)
    both = torch.isfinite(pushes.time[:, 1:])
    assert (gap >= pushes.duration[:, 1:] - 1e-9)[both].all()
    times = pushes.time[torch.isfinite(pushes.time)]
    assert times.min() >= 1.0
    assert times.max() < 60.0
    torch.testing.assert_close(times / 0.04, (times / 0.04).round(), atol=1e-6, rtol=0)
    assert len(trials) == 3 * 3 * 4 * 50 + 50


def test_directions_are_uniform_on_the_sphere_and_sizes_as_asked(spherical):
    _, trials, pushes = spherical
    impulse = pushes.force.double().norm(dim=-1) * pushes.duration / UNIT
    real = torch.isfinite(pushes.time)
    size = torch.tensor(trials["impulse"].to_numpy(dtype=float))[:, None].expand_as(impulse)
    torch.testing.assert_close(impulse[real], size[real], atol=1e-5, rtol=1e-5)
    pushed = real & (size > 0)
    unit = torch.nn.functional.normalize(pushes.force.double()[pushed], dim=-1)
    error = 1 / len(unit) ** 0.5
    assert (unit.mean(0).abs() < 4 * error).all()
    second = unit.T @ unit / len(unit)
    assert (second - torch.eye(3) / 3).abs().max() < 4 * error


def test_a_trial_draws_from_its_own_seed(spherical):
    battery, trials, pushes = spherical
    alone = plan_pushes(battery, trials.iloc[700:701])
    count = int(torch.isfinite(alone.time).sum())
    torch.testing.assert_close(pushes.time[700, :count], alone.time[0, :count])
    torch.testing.assert_close(pushes.force[700, :count], alone.force[0, :count])
    assert not torch.isfinite(pushes.time[700, count:]).any()
    other = plan_pushes(battery, trials.iloc[701:702])
    assert alone.time[0, 0] != other.time[0, 0]


def test_random_pushes_are_counted_until_the_fall(compose_config):
    """Limp it falls by itself, before or at its first push; held it withstands small ones."""
    battery = load_battery(
        "spherical", point=["torso", "pelvis"], impulses=[0.02], duration=0.1, starts=4,
        interval=0.5, end_time=4.0,
    )  # fmt: skip
    cfg = compose_config().env
    held = run_battery(battery, cfg, None)
    assert not held["fell"].any()
    pushed = held["impulse"] > 0
    unit = held["force_n"][pushed].iloc[0] * 0.1 / 0.02
    pushes = plan_pushes(battery, plan_trials(battery, unit, 0))
    assert held["withstood"].tolist() == torch.isfinite(pushes.time).sum(1).tolist()
    assert held["withstood"][pushed].sum() > 20
    limp = run_battery(battery, cfg, None, servos=False)
    assert limp["fell"].all()
    assert (limp["withstood"] <= held["withstood"]).all()
    assert limp["withstood"].max() <= 1


def test_a_push_that_makes_it_fall_is_not_withstood():
    class Fallen:
        battery = load_battery("spherical")
        fell = torch.tensor([True, True, False, True])
        fall_time = torch.tensor([4.2, 2.0, torch.nan, 1.5])

    time = torch.tensor([[2.0, 3.0, 4.0, 9.0], [2.5, 3.0, 4.0, 9.0], [2.0, 3.0, 4.0, torch.inf],
                         [1.2, 3.0, 4.0, 9.0]])  # fmt: skip
    assert withstood(time, Fallen()).tolist() == [2, 0, 3, 0]
