"""What made-up trials feel at rest, by hand."""

import math
from dataclasses import replace

import pandas as pd
import pytest
import torch
from tensordict import TensorDict

from tests.evaluation.moments import ended, moment
from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.rest import FIGURES, Rest
from zfall.robots import ZEROTH01
from zfall.robots.servos import STS3215, STS3250

WARM = {"thermal_resistance": 4.0, "thermal_time_constant": 300.0, "stall_current": 3.0}
LEGS = dict.fromkeys(ZEROTH01.joints, STS3250)


def record(num: int = 1, **values: torch.Tensor) -> TensorDict:
    """A step in which nothing moves."""
    still = {
        "joint_torque": torch.zeros(num, 20),
        "joint_velocity": torch.zeros(num, 20),
        "target": torch.zeros(num, 20),
        "feet_contact": torch.ones(num, 2, dtype=torch.bool),
        "feet_position": torch.zeros(num, 2, 3),
        "push": {"force": torch.zeros(num, 3)},
    }
    return TensorDict(still | values, [num])


def make(servos: dict | None, num: int = 1) -> HumanoidEnv:
    return HumanoidEnv(num_envs=num, control_dt=0.04, servos=servos)


def test_loads_of_a_constant_torque_and_speed():
    """1.0 N m in one knee of rating 1.25 N m: 0.8 of it, and 1 / sqrt(20) over all joints."""
    rest, knee = Rest(make(LEGS)), ZEROTH01.joints.index("left_knee_pitch")
    torque = torch.zeros(1, 20)
    torque[0, knee] = 1.0
    for step in range(10):
        td = record(joint_torque=torque, joint_velocity=torch.full((1, 20), 0.5))
        rest.before(td, moment([step < 7], -1.0))  # what follows a fall counts for nothing
    table = rest.table(ended([False]))
    assert table["rest_torque_rms/left_knee_pitch"].item() == pytest.approx(1.0)
    assert table["rest_torque_rms"].item() == pytest.approx(20**-0.5)
    assert table["rest_load"].item() == pytest.approx(1.0 / 1.25)
    assert table["rest_load/left_knee_pitch"].item() == pytest.approx(1.0 / 1.25)
    assert table["rest_joint_speed"].item() == pytest.approx(0.5)
    assert table["rest_at_limit"].item() == 0.0
    assert table["rest_steps"].item() == 0.0
    assert table["peak_servo_temperature"].isnan().all()  # no thermal constants are published


def test_the_last_three_seconds_count_by_themselves():
    """Of 75 control steps the first still carries 2 N m, the others 0.5, over a rating of 1.25."""
    rest, knee = Rest(make(LEGS)), ZEROTH01.joints.index("left_knee_pitch")
    lifted = torch.tensor([[False, True]])
    for step in range(130):
        torque, place = torch.zeros(1, 20), torch.zeros(1, 2, 3)
        torque[0, knee] = 2.0 if step < 56 else 0.5
        place[0, 0, 0] = 0.1 * ((step > 4) + (step > 90))  # two steps
        stands = lifted if step in (4, 90) else torch.ones(1, 2, dtype=torch.bool)
        td = record(joint_torque=torque, feet_contact=stands, feet_position=place)
        (rest.before if step == 0 else rest.update)(td, moment([True]))
    table = rest.table(ended([False]))
    settled = ((2.0**2 + 74 * 0.5**2) / 75) ** 0.5 / 1.25
    assert table["settled_load"].item() == pytest.approx(settled)
    assert table["settled_load/left_knee_pitch"].item() == pytest.approx(settled)
    mean = (56 * 2.0**2 + 74 * 0.5**2) / 130
    assert table["rest_load"].item() == pytest.approx(mean**0.5 / 1.25, rel=1e-5)
    assert (table["rest_steps"].item(), table["settled_steps"].item()) == (2, 1)
    assert rest.table(ended([True]))["settled_load"].isnan().all()


def test_a_servo_without_a_rating_has_no_load():
    table = Rest(make(LEGS | {"left_elbow_roll": STS3215}))
    table.before(record(), moment([True], -1.0))
    columns = table.table(ended([False]))
    assert "rest_load/left_elbow_roll" not in columns
    assert "rest_load/left_knee_pitch" in columns
    published = Rest(make(None))
    published.before(record(), moment([True], -1.0))
    assert published.table(ended([False]))["rest_load"].isnan().all()


def test_the_limit_is_that_at_the_voltage_of_the_trial():
    env = make(LEGS, num=2)
    voltage = torch.tensor([[0.95], [1.0]])
    env.set_physics_params(TensorDict({"battery_voltage": voltage}, [2]))
    rest = Rest(env)
    torque = torch.full((2, 20), 0.92 * STS3250.motor_torque())
    rest.before(record(2, joint_torque=torque), moment([True, True], -1.0))
    assert rest.table(ended([False] * 2))["rest_at_limit"].tolist() == [1.0, 0.0]


def test_the_winding_is_as_warm_as_ten_minutes_of_the_load_make_it():
    """25 + R P (1 - exp(-600 / 300)), P = 12 V x 3 A x (torque / motor torque)^2."""
    rest = Rest(make(dict.fromkeys(ZEROTH01.joints, replace(STS3250, **WARM))))
    torque = torch.zeros(1, 20)
    torque[0, 5] = -1.5
    rest.before(record(joint_torque=torque), moment([True], -1.0))
    heat = 12 * 3 * (1.5 / STS3250.motor_torque()) ** 2
    warm = rest.table(ended([False]))["peak_servo_temperature"].item()
    assert warm == pytest.approx(25 + 4 * heat * (1 - math.exp(-2)), rel=1e-5)


def test_steps_are_counted_until_the_fall_and_from_two_centimetres_on():
    rest = Rest(make(None))
    lifted = torch.tensor([[False, True]])
    rest.before(record(), moment([True], -1.0))
    for place in (0.03, 0.04, 0.10):  # 3 cm, 1 cm, 6 cm from where it stood
        away = torch.zeros(1, 2, 3)
        away[0, 0, 0] = place
        rest.update(record(feet_contact=lifted, feet_position=away), moment([True]))
        rest.update(record(feet_position=away), moment([True]))
    assert rest.table(ended([False]))["rest_steps"].item() == 2


def test_a_pushed_trial_says_nothing_of_rest():
    rest = Rest(make(LEGS))
    rest.before(record(), moment([True], -1.0))
    rest.update(record(push={"force": torch.tensor([[0.0, 1.0, 0.0]])}), moment([True]))
    assert all(value.isnan().all() for value in rest.table(ended([False])).values())


def test_a_push_after_the_end_of_a_trial_counts_for_nothing():
    """It acts on the world while others of the chunk go on, and never on the trial run alone."""
    rest = Rest(make(LEGS))
    rest.before(record(), moment([True], -1.0))
    rest.update(record(push={"force": torch.tensor([[0.0, 1.0, 0.0]])}), moment([False]))
    assert rest.table(ended([True]))["rest_joint_speed"].item() == 0.0


def test_the_summary_is_over_trials_without_a_push():
    columns = {name: [1.0, 3.0, float("nan")] for name in FIGURES}
    joint = {"rest_torque_rms/left_knee_pitch": [3.0, 4.0, float("nan")]}
    trials = pd.DataFrame({"impulse": [0.0, 0.0, 0.5], **columns, **joint})
    summary = Rest.summary(trials)
    assert all(summary[name] == 2.0 for name in FIGURES)
    assert summary["rest"]["50 %"].tolist() == [2.0] * len(FIGURES)
    (row,) = summary["rest_servos"].to_dict("records")
    assert row["torque_rms"] == pytest.approx(12.5**0.5)
    assert math.isnan(row["load"])
