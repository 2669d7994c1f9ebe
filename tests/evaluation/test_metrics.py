"""Outcomes of scripted trials."""

import torch
from tensordict import TensorDict

from zfall.evaluation.battery import load_battery
from zfall.evaluation.metrics import Outcomes


def record(regions: int, **values: torch.Tensor) -> TensorDict:
    upright = torch.tensor([[1.0, 0, 0, 0]] * 3)
    quantities = {
        "contact_force_peak": torch.zeros(3, regions),
        "diverged": torch.zeros(3, 1, dtype=torch.bool),
        "base_orientation": upright,
        "com_position": torch.tensor([[0.0, 0, 0.22]] * 3),
        "base_acceleration_peak": torch.full((3, 1), 9.81),
    }
    return TensorDict(quantities | values, batch_size=[3])


def test_fall_rise_and_stand_are_told_apart(make_base):
    """World 0 stands; world 1 touches with the head 0.4 s after the push; world 2 ends low."""
    env = make_base(num_envs=3)
    battery = load_battery("planar", push_time=0.2, end_time=1.0)
    outcomes = Outcomes(env, battery)
    regions = len(env.regions)
    for step in range(25):
        touch = torch.zeros(3, regions)
        if step == 14:  # ends at 0.6 s
            touch[1, 0] = 50.0
        low = torch.tensor([[0.0, 0, 0.22], [0, 0, 0.22], [0, 0, 0.1]])
        outcomes.update(record(regions, contact_force_peak=touch, com_position=low))
    table = outcomes.table()
    assert table["recovered"].tolist() == [True, False, False]
    assert table["fell"].tolist() == [False, True, False]
    assert abs(table["time_to_fall_s"][1] - 0.4) < 1e-6
    assert table["peak_contact_force/head"].tolist() == [0.0, 50.0, 0.0]


def test_peaks_before_the_push_do_not_count(make_base):
    env = make_base(num_envs=3)
    outcomes = Outcomes(env, load_battery("planar", push_time=0.2, end_time=1.0))
    shock = torch.full((3, 1), 99.0)
    outcomes.update(record(len(env.regions), base_acceleration_peak=shock))
    for _ in range(10):
        outcomes.update(record(len(env.regions)))
    assert (outcomes.table()["peak_base_acceleration"] < 10).all()


def test_peaks_count_for_half_a_second_after_the_touch_and_then_the_trial_is_settled(make_base):
    """World 0 falls at the end of step 9; steps 10 to 21 end within 0.5 s of it, 23 does not."""
    env = make_base(num_envs=3)
    outcomes = Outcomes(env, load_battery("planar", push_time=0.2, end_time=2.0))
    for step in range(1, 26):
        force, shock = torch.zeros(3, len(env.regions)), torch.full((3, 1), 10.0)
        force[0, 1] = 50.0 if step == 9 else 0.0
        shock[0] = {21: 70.0, 23: 99.0}.get(step, 10.0)
        td = record(len(env.regions), contact_force_peak=force, base_acceleration_peak=shock)
        outcomes.update(td)
        assert outcomes.settled.tolist() == [step >= 22, False, False]
    assert outcomes.table()["peak_base_acceleration"][0] == 70.0
