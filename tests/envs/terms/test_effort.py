"""Effort terms by hand."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.terms.effort import (
    action_rate,
    commanded_velocity,
    joint_effort,
    joint_limits,
    joint_torque,
    servo_power,
)

NONE = TensorDict(batch_size=[1])


def one(**values: list[float]) -> TensorDict:
    """A TensorDict of one world."""
    return TensorDict({key: torch.tensor([value]) for key, value in values.items()}, [1])


def test_action_rate_is_the_squared_change_of_all_joints_or_of_one():
    td = one(action=[1.0, 2.0], last_action=[0.0, 4.0])
    assert action_rate(td, td).item() == 5.0
    assert action_rate(td, td, per_joint=True).item() == 2.5


def test_commanded_velocity_is_at_its_cutoff_where_the_norm_is():
    """0.3 and 0.4 of pi rad/s: 0.5 pi together; beyond 1 an action asks for no more."""
    values = {"limit": math.pi, "cutoff": 0.5 * math.pi, "epsilon": 0.02}
    assert commanded_velocity(one(action=[0.3, -0.4]), NONE, **values).item() == pytest.approx(0.02)
    assert commanded_velocity(one(action=[0.0, 0.0]), NONE, **values).item() == 1.0
    most, more = (commanded_velocity(one(action=[a, 0.0]), NONE, **values) for a in (1.0, 7.0))
    assert_close(most, more)


def test_joint_effort_is_at_its_cutoff_there():
    assert joint_effort(NONE, one(joint_effort=[0.42]), cutoff=0.42, epsilon=0.01).item() == (
        pytest.approx(0.01)
    )
    half = joint_effort(NONE, one(joint_effort=[0.21]), cutoff=0.42, epsilon=0.01).item()
    assert half == pytest.approx(0.01**0.25)


def test_joint_torque_is_the_sum_of_squares():
    assert joint_torque(NONE, one(joint_torque=[3.0, -4.0])).item() == 25.0


def test_power_taken_out_counts_as_power_put_in():
    td = one(joint_torque=[2.0, -3.0, 1.0], joint_velocity=[0.5, 2.0, 0.0])
    assert servo_power(NONE, td).item() == 7.0


def test_limits_count_what_is_beyond_them():
    bounds = torch.tensor([[-1.0, 1.0], [0.0, 2.0], [-1.0, 1.0]])
    td = one(joint_position=[1.25, -0.5, 0.9])
    assert joint_limits(NONE, td, joint_range=bounds).item() == 0.75
