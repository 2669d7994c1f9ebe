"""The twin: the same trials for all policies, alone and in any company."""

import numpy as np
import pandas as pd
import pytest
import torch

from zfall.evaluation.battery import battery_env, run_battery
from zfall.evaluation.candidate import load_candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.draws import COLUMN

# Pushes begin early: what differs between companies does so from the first step on.
SHORT = {"starts": 3, "directions": 8, "impulses": [0.3, 0.6], "push_time": 0.2, "end_time": 0.6}


def trials_of(name: str, *, battery: str = "twin", **given) -> pd.DataFrame:
    options = SHORT | given.pop("options", {})
    candidate = load_candidate(name)
    return run_battery(
        load_battery(battery, **options),
        candidate.env_cfg,
        candidate.actor,
        servos=candidate.servos,
        **given,
    )


@pytest.fixture(scope="module")
def still() -> pd.DataFrame:
    return trials_of("pose_hold", num_envs=128)


@pytest.mark.parametrize("name", ["pose_hold", "best"])
def test_a_trial_is_the_same_alone_and_in_any_company(name, still):
    """72 trials: 128 worlds at once, 64 in two rounds, and one trial of them alone."""
    wide = still if name == "pose_hold" else trials_of(name, num_envs=128)
    pd.testing.assert_frame_equal(wide, trials_of(name, num_envs=64), check_exact=True)
    alone = trials_of(name, only=[67])
    pd.testing.assert_frame_equal(wide[67:68].reset_index(drop=True), alone, check_exact=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pose_hold", "best"])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_whole_battery_is_the_same_in_any_company(name, threads):
    """720 trials with all of their 7 seconds; threads of torch and of the physics."""
    options = {"starts": 20, "directions": 12, "impulses": [0.2, 0.5], "push_time": 3.0}
    options |= {"end_time": 7.0}
    torch.set_num_threads(threads)
    wide = trials_of(name, num_envs=512, options=options)
    torch.set_num_threads(1)
    few = trials_of(name, num_envs=64, options=options)
    pd.testing.assert_frame_equal(wide, few, check_exact=True)
    for trial in (0, 300, 719):
        alone = trials_of(name, only=[trial], options=options)
        row = wide[trial : trial + 1].reset_index(drop=True)
        pd.testing.assert_frame_equal(row, alone, check_exact=True)


def test_all_policies_meet_the_same_robots(still):
    drawn = [column for column in still if str(column).startswith(COLUMN)]
    others = trials_of("atalante", only=[3, 40], options={"end_time": 0.4})
    few = [name for name in drawn if not name.endswith("latency")]  # whole steps of its physics
    assert len(few) > 10
    pd.testing.assert_frame_equal(
        still.iloc[[3, 40]][few].reset_index(drop=True), others[few], check_exact=True
    )


def test_draws_are_those_of_the_definition(still):
    """Quartiles of uniform draws lie within 4 standard errors of theirs, 72 trials."""
    bounds = {
        "backlash": (0.00873, 0.01745),
        "battery_voltage": (0.925, 1.05),
        "foot_friction": (0.4, 1.2),
        "supply_resistance": (0.05, 0.15),
        "command_latency": (0.010, 0.035),
    }
    for name, (low, high) in bounds.items():
        share = (still[COLUMN + name] - low) / (high - low)
        tolerance = 0.1 if name.endswith("latency") else 1e-6  # rounded to 4 ms
        assert share.between(-tolerance, 1 + tolerance).all(), name
        assert abs(share.mean() - 0.5) < 4 / (12 * 72) ** 0.5, name
    friction = still[COLUMN + "load_friction"]  # root mean square of 20 of U(0.7, 1.3)
    assert abs(friction.mean() - (1 + 0.6**2 / 12) ** 0.5) < 0.01
    pairs = np.corrcoef(still[[COLUMN + name for name in bounds]].T)
    assert abs(pairs - np.eye(len(bounds))).max() < 4 / 72**0.5  # of each other independent


def test_motors_without_power_do_nothing_in_the_twin_either():
    fallen = trials_of("limp", only=[0, 1], options={"push_time": 1.9, "end_time": 2.1})
    assert fallen["fell"].all()
    assert (fallen["time_to_fall_s"] < 0).all()


@pytest.mark.parametrize("ramp", ["twin_ramp39", "twin_ramp10_28"])
def test_a_ramp_acts_between_latency_and_gears(ramp):
    battery = load_battery(ramp)
    env, _, _ = battery_env(battery, load_candidate("pose_hold").env_cfg, 2)
    order = [name for name in env.transform.by_name if name.startswith("world_")]
    ends = ["world_latency", "world_jitter", "world_planner", "world_backlash"]
    assert order[-4:] == ends
    planner = env.transform.by_name["world_planner"]
    env.reset()
    assert planner.velocity == float("inf")
    if ramp == "twin_ramp39":
        assert planner.acceleration == pytest.approx(254 * 100 * 2 * np.pi / 4096, rel=1e-3)
    else:
        assert ((planner.drawn >= 10) & (planner.drawn <= 28)).all()
