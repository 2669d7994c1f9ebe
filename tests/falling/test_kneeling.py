"""Stable kneels, triggers and impacts on made-up trials."""

import numpy as np
import pandas as pd
import pytest
import torch
from tensordict import TensorDict

from tests.evaluation.test_metrics import record
from zfall.evaluation.results import kneel_table
from zfall.falling.kneeling import Kneeling, compare_falls, summarize_kneel


def kneel(env, **values) -> TensorDict:
    """Three worlds; world 0 rests on its left knee."""
    force = torch.zeros(3, len(env.regions))
    force[0, env.regions.index("left_knee")] = 10.0
    return record(len(env.regions), contact_force_peak=force, **values)


def test_a_kneel_is_stable_after_half_a_second_of_rest(make_base):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    counted, first = torch.ones(3, dtype=torch.bool), torch.tensor([True, False, False])
    steps = round(0.5 / env.control_dt + 0.49)
    for step in range(steps):
        assert not kneeling.kneeled.any()
        kneeling.update(kneel(env), counted, first & (step == 0), step * env.control_dt)
    assert kneeling.kneeled.tolist() == [True, False, False]
    took = kneeling.table()["kneel_time_s"]
    assert took[0] == pytest.approx((steps - 1) * env.control_dt, abs=1e-6)
    assert took[1:].isnan().all()
    trigger = kneeling.table()["trigger_s"]
    assert trigger[0] == 0.0  # there is no mode: the first touch
    assert trigger[1:].isnan().all()


def test_triggers_are_counted_from_the_push_and_not_before_it(make_base):
    """World 0 gave up before the push, world 1 does 0.08 s after it, world 2 never."""
    env = make_base(num_envs=3)
    kneeling, counted = Kneeling(env), torch.ones(3, dtype=torch.bool)

    def modes(*mode: int) -> TensorDict:
        td = kneel(env)
        return td.set("mode", torch.nn.functional.one_hot(torch.tensor(mode), 3).float())

    nobody = torch.zeros(3, dtype=torch.bool)
    kneeling.before(modes(0, 0, 0), nobody)
    kneeling.before(modes(1, 0, 0), nobody)
    for step in range(1, 16):
        td = modes(1, int(step >= 2), 0)
        kneeling.update(td, counted, ~counted, step * 0.04)
    table = kneeling.table()
    assert table["gave_up_before"].tolist() == [True, False, False]
    assert table["trigger_s"].nan_to_num(-1.0).tolist() == pytest.approx([-1.0, 0.08, -1.0])
    assert kneeling.kneeled.tolist() == [True, False, False]
    assert table["kneel_time_s"].isnan().all()  # of world 0 it is not known


def test_without_modes_a_touch_before_the_push_is_giving_up(make_base):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    kneeling.before(kneel(env), torch.tensor([True, False, False]))
    counted = torch.ones(3, dtype=torch.bool)
    kneeling.update(kneel(env), counted, torch.tensor([False, True, False]), 0.04)
    table = kneeling.table()
    assert table["gave_up_before"].tolist() == [True, False, False]
    assert table["trigger_s"].nan_to_num(-1.0).tolist() == pytest.approx([-1.0, 0.04, -1.0])


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("base_linear_velocity", torch.tensor([0.0, 0.0, 0.11])),
        ("base_angular_velocity", torch.tensor([0.11, 0.0, 0.0])),
        ("joint_velocity", torch.nn.functional.one_hot(torch.tensor(7), 20) * -0.11),
        ("base_orientation", torch.tensor([np.cos(0.31), 0.0, np.sin(0.31), 0.0])),
    ],
)
def test_what_moves_or_leans_does_not_rest(make_base, key, value):
    env = make_base(num_envs=3)
    for scale, rests in ((1.0, False), (0.5, True)):
        if key == "base_orientation":
            value = torch.tensor([np.cos(0.31 * scale), 0.0, np.sin(0.31 * scale), 0.0])
            moved = value.float().repeat(3, 1)
        else:
            moved = (scale * value).float().repeat(3, 1)
        kneeling = Kneeling(env)
        td = kneel(env, **{key: moved})
        for step in range(30):
            kneeling.update(td, torch.ones(3).bool(), torch.zeros(3).bool(), step * 0.04)
        assert bool(kneeling.kneeled[0]) is rests


@pytest.mark.parametrize("region", ["torso", "head"])
def test_a_torso_or_head_on_the_floor_is_no_kneel_and_a_hand_is(make_base, region):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    td = kneel(env)
    for world, other in enumerate((region, "left_hand", "left_shin")):
        td["contact_force_peak"][world, env.regions.index("left_knee")] = 5.0
        td["contact_force_peak"][world, env.regions.index(other)] = 5.0
    for step in range(30):
        kneeling.update(td, torch.ones(3).bool(), torch.zeros(3).bool(), step * 0.04)
    assert kneeling.kneeled.tolist() == [False, True, True]


def test_impact_energy_is_that_of_the_step_before_the_touch(make_base):
    env = make_base(num_envs=3)
    kneeling, counted = Kneeling(env), torch.ones(3, dtype=torch.bool)
    fast, slow = torch.tensor([[0.0, 0.0, -2.0]] * 3), torch.zeros(3, 3)
    kneeling.update(kneel(env, com_velocity=fast), counted, ~counted, 0.1)
    touched = torch.tensor([True, False, False])
    kneeling.update(kneel(env, com_velocity=slow), counted, touched, 0.2)
    energy = kneeling.table()["impact_energy"]
    assert energy[0].item() == pytest.approx(0.5 * env.mass * 4.0)
    assert energy[1:].isnan().all()


def test_impact_energy_is_of_the_mass_that_each_world_has_then(make_base):
    """Masses are drawn after the measuring has been set up: 0.8, 1 and 1.2 of the nominal one."""
    env = make_base(num_envs=3)
    kneeling, counted = Kneeling(env), torch.ones(3, dtype=torch.bool)
    links = env.physics_param_spec["link_mass"].shape[1]
    factor = torch.tensor([[0.8], [1.0], [1.2]])
    env.set_physics_params(TensorDict({"link_mass": factor.repeat(1, links)}, batch_size=[3]))
    fast = torch.tensor([[0.0, 0.0, -2.0]] * 3)
    kneeling.update(kneel(env, com_velocity=fast), counted, counted, 0.1)
    energy = kneeling.table()["impact_energy"]
    assert energy.tolist() == pytest.approx((0.5 * env.mass * 4.0 * factor[:, 0]).tolist())


def test_contact_impulses_add_up_while_the_trial_goes_on(make_base):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    given = torch.full((3, len(env.regions)), 0.25)
    counted = torch.tensor([True, False, True])
    for _ in range(4):
        kneeling.update(kneel(env, contact_impulse=given), counted, ~counted, 0.1)
    impulse = kneeling.table()["contact_impulse/torso"]
    assert impulse.tolist() == [1.0, 0.0, 1.0]


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
    shown = kneel_table(summary).set_index("push")["peak_base_acceleration"]
    assert shown[["I 1", "force [N] (20, 0)"]].tolist() == ["50", "999"]
    many = pd.concat([trials] * 5, ignore_index=True)
    entry = summarize_kneel(many)["by_impulse"]["1"]  # 20 falls, deviation of their mean 5
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
    table = compare_falls({"one": one, "two": two}).set_index("run")
    assert table["falls"].tolist() == [30, 30]
    assert table["peak_base_acceleration"].tolist() == [40.0, 80.0]
    assert table["peak_torso_head_force"].tolist() == pytest.approx([170 / 3] * 2)
    for end in ("low", "high"):  # of every sample of pairs it is the same
        assert table[f"peak_base_acceleration_ratio_{end}"].tolist() == pytest.approx([1.0, 0.5])
        assert table[f"peak_joint_torque_ratio_{end}"].tolist() == pytest.approx([1.0, 2.0])
    beside = compare_falls({"one": one, "still": still}).set_index("run")
    assert np.isnan(beside["peak_joint_torque_ratio_low"]["still"])  # nothing to divide by
