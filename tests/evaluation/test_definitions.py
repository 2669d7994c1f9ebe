"""Plans of the batteries, against counts and the statistics of what they draw."""

import numpy as np
import pytest
import torch

from zfall.evaluation.definitions import load_battery, plan_pushes, plan_trials
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


def test_kneel_tries_the_listed_forces_and_a_grid():
    battery = load_battery("kneel")
    trials = plan_trials(battery, UNIT, seed=0)
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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": "abc"}, "starts must be a whole number, got abc"),
        ({"starts": 2.5}, "starts must be a whole number, got 2.5"),
        ({"directions": True}, "directions must be a whole number, got True"),
        ({"impulses": 0.4}, "impulses must be a list of numbers, .*, got 0.4"),
        ({"impulses": [0.4, "x"]}, "impulses must be a list of numbers, .*, got"),
        ({"end_time": "late"}, "end_time must be a number, got late"),
        ({"duration": "short"}, "duration must be a number or a list of numbers, got short"),
    ],
)
def test_options_of_another_kind_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        load_battery("planar", **options)


def test_durations_and_sizes_that_make_no_push_are_refused():
    with pytest.raises(ValueError, match="duration must be positive, got 0"):
        load_battery("planar", duration=0)
    with pytest.raises(ValueError, match="impulses must be positive"):
        load_battery("spherical", impulses=[0.2, -0.1])


@pytest.mark.parametrize("end", [3.0, 3.1])
def test_a_trial_does_not_end_before_its_push_does(end):
    """The push lasts from 3.0 to 3.1 s."""
    with pytest.raises(ValueError, match="end_time must be later than the end of the push, 3.1 s"):
        load_battery("planar", end_time=end)
    assert load_battery("planar", end_time=3.2).end_time == 3.2


@pytest.mark.parametrize("name", ["planar", "envelope"])
def test_pushes_of_several_durations_are_not_mixed(name):
    with pytest.raises(ValueError, match=f"duration of battery {name} must be one"):
        load_battery(name, duration=[0.1, 0.4])


def test_pushes_may_begin_in_any_physics_step_of_a_control_step():
    """Ten of them, each as likely: of 960 pushes 96, with a deviation of 9.3."""
    battery = load_battery("planar", impulses=[1.0], starts=40, directions=24)
    trials = plan_trials(battery, ZEROTH01.impulse_unit, seed=0)
    planned = plan_pushes(battery, trials)
    sooner = planned.sooner(0.04, 0.004, seed=1)
    steps = (planned.time - sooner.time)[trials["impulse"].to_numpy() > 0] / 0.004
    torch.testing.assert_close(steps, steps.round(), rtol=0, atol=1e-6)
    count = torch.bincount(steps.flatten().round().long())
    assert len(count) == 10
    assert 96 - 5 * 9.3 < int(count.min()) <= int(count.max()) < 96 + 5 * 9.3
    assert torch.equal(sooner.force, planned.force)
    assert torch.equal(planned.sooner(0.04, 0.004, seed=1).time, sooner.time)
    assert not torch.equal(planned.sooner(0.04, 0.004, seed=2).time, sooner.time)
