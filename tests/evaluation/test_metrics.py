"""Outcomes of scripted trials."""

import math

import pytest
import torch
from tensordict import TensorDict

from zfall.evaluation.definitions import load_battery
from zfall.evaluation.metrics import Outcomes, spectral_smoothness


def record(regions: int, **values: torch.Tensor) -> TensorDict:
    upright = torch.tensor([[1.0, 0, 0, 0]] * 3)
    quantities = {
        "contact_force_peak": torch.zeros(3, regions),
        "diverged": torch.zeros(3, 1, dtype=torch.bool),
        "base_orientation": upright,
        "com_position": torch.tensor([[0.0, 0, 0.22]] * 3),
        "base_acceleration_peak": torch.full((3, 1), 9.81),
        "joint_torque_peak": torch.full((3, 1), 0.5),
        "target": torch.zeros(3, 2),
        "joint_torque": torch.zeros(3, 20),
        "joint_velocity": torch.zeros(3, 20),
        "joint_position": torch.zeros(3, 20),
        "com_velocity": torch.zeros(3, 3),
        "base_linear_velocity": torch.zeros(3, 3),
        "base_angular_velocity": torch.zeros(3, 3),
        "contact_impulse": torch.zeros(3, regions),
        "angular_momentum": torch.zeros(3, 3),
        "feet_contact": torch.ones(3, 2, dtype=torch.bool),
        "feet_position": torch.zeros(3, 2, 3),
        "feet_orientation": upright[:, None].expand(3, 2, 4),
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


def test_a_robot_whose_body_meets_no_floor_has_fallen_once_it_lies(make_base):
    """Of 0.220 m the center of mass is at 0.068 m, then, of world 1 alone, at 0.064 m: 0.3 is 0.066."""
    env = make_base(num_envs=3)
    outcomes = Outcomes(env, load_battery("planar", push_time=0.2, end_time=1.0))
    regions, height = len(env.regions), env.robot.com_height
    for share in (0.31, 0.29, 0.31):
        places = torch.tensor([[0.0, 0, height], [0, 0, share * height], [0, 0, 0.31 * height]])
        outcomes.update(record(regions, com_position=places))
    assert outcomes.fell.tolist() == [False, True, False]


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
        td = record(
            len(env.regions),
            contact_force_peak=force,
            base_acceleration_peak=shock,
            joint_torque_peak=0.1 * shock,
        )
        outcomes.update(td)
        assert outcomes.settled.tolist() == [step >= 22, False, False]
    assert outcomes.table()["peak_base_acceleration"][0] == 70.0
    assert outcomes.table()["peak_joint_torque"][0] == 7.0


@pytest.mark.parametrize(("length", "frequency"), [(50, 5.0), (50, 12.5), (51, 25 / 51 * 7)])
def test_smoothness_of_a_sine_by_hand(length, frequency):
    """One component of amplitude 0.3: ``2 / (n f_s) 0.3 f``; the offset and a still joint add 0."""
    time = torch.arange(length, dtype=torch.float64) / 25
    sine = 0.7 + 0.3 * torch.cos(2 * math.pi * frequency * time)
    signal = torch.stack([sine, torch.ones(length, dtype=torch.float64)], -1)[None]
    expected = 2 / (length // 2 * 25) * 0.3 * frequency / 2  # mean of two joints
    assert spectral_smoothness(signal, 0.04).item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("fall", [5, 12, 13])
def test_a_trial_that_was_over_before_its_push_has_nothing_measured(make_base, fall):
    """World 0 falls half a second before the first step of the push, at 1 s, or earlier still."""
    env = make_base(num_envs=3)
    outcomes = Outcomes(env, load_battery("planar", push_time=1.0, end_time=2.0))
    regions = len(env.regions)
    for step in range(1, 51):
        touch = torch.zeros(3, regions)
        touch[0, 0], touch[1, 0] = 50.0 * (step == fall), 40.0 * (step >= 24)
        outcomes.update(record(regions, contact_force_peak=touch))
    table = outcomes.table()
    assert table["fell"].tolist() == [True, True, False]
    assert table["target_smoothness"].isna().tolist() == [True, True, False]
    peaks = ("peak_base_acceleration", "peak_contact_force", "peak_tilt")
    for column in (*peaks, "contact_impulse/torso"):
        assert table[column].isna().tolist() == [True, False, False]
    assert table["peak_contact_force/head"].tolist()[1:] == [40.0, 0.0]


def test_smoothness_is_that_of_the_two_seconds_before_the_push(make_base):
    """A sine in world 0 until the push at 3 s, after a jump long before and one at the push."""
    env = make_base(num_envs=3)
    outcomes = Outcomes(env, load_battery("planar", push_time=3.0, end_time=4.0))
    window = []
    for step in range(1, 101):
        target = torch.zeros(3, 2)
        target[0] = 9.0 if step <= 25 or step > 75 else 0.3 * math.sin(step)
        if 25 < step <= 75:
            window.append(target)
        outcomes.update(record(len(env.regions), target=target))
    expected = spectral_smoothness(torch.stack(window, 1), 0.04)
    assert outcomes.table()["target_smoothness"].tolist() == expected.tolist()
    assert expected[0] > 0.001
