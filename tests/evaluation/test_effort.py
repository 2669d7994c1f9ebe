"""Effort of made-up trials, by hand."""

import pytest
import torch
from tensordict import TensorDict

from tests.evaluation.moments import ENDED, moment
from zfall.evaluation.effort import Effort
from zfall.robots import ZEROTH01
from zfall.robots.servos import STS3250


def test_sums_over_a_constant_torque_and_speed(make_base):
    """0.5 N m at 2 rad/s in all 20 joints for 10 steps of 40 ms: 20 W for 0.4 s are 8 J."""
    effort = Effort(make_base(num_envs=2))
    for step in range(10):
        td = TensorDict(
            {
                "joint_torque": torch.tensor([[0.5] * 20, [-1.0] * 10 + [0.0] * 10]),
                "joint_velocity": torch.full((2, 20), 2.0),
                "target": torch.zeros(2, 20),
            },
            [2],
        )
        effort.update(td, moment([True, step < 5]))
    table = effort.table(ENDED)
    assert table["energy"].tolist() == pytest.approx([8.0, 20 * 0.2])
    assert table["joint_torque_rms"].tolist() == pytest.approx([0.5, 0.5**0.5])
    assert table["target_jerk"].tolist() == [0.0, 0.0]


def test_saturation_is_the_share_of_torques_at_their_limit(make_base):
    env = make_base(num_envs=1)
    effort = Effort(env)
    limit = torch.tensor(
        [float(env.simulation.model.actuator(j).forcerange[1]) for j in env.robot.joints]
    )
    torque = limit * torch.tensor([1.0] * 3 + [-0.96] * 2 + [0.9] * 15)
    td = TensorDict(
        {"joint_torque": torque[None], "joint_velocity": torch.zeros(1, 20),
         "target": torch.zeros(1, 20)}, [1]
    )  # fmt: skip
    effort.update(td, moment([True]))
    assert effort.table(ENDED)["torque_saturation"].item() == pytest.approx(5 / 20)


def test_the_limit_is_what_the_servos_could_give_in_the_step(make_base):
    """At 11.16 V, and in the second world with the sag of a supply of 0.15 Ohm as well."""
    env = make_base(num_envs=2, servos=dict.fromkeys(ZEROTH01.joints, STS3250), servo_dynamics=True)
    supply = {
        "battery_voltage": torch.full((2, 1), 0.93),
        "supply_resistance": torch.tensor([[0.0], [0.15]]),
    }
    env.set_physics_params(TensorDict(supply, [2]))
    env.reset()
    far = TensorDict({"target": env.stand_position.repeat(2, 1) + 1.0}, [2])
    share = env.step(far.clone())["next", "supply_voltage"] / 12.0
    assert share[0] == pytest.approx(0.93)
    assert share[1] < 0.9 * share[0]
    env.step(far.clone())
    effort, largest = Effort(env), STS3250.before_gears().motor_torque() * share
    for part in (0.96, 0.94):
        td = TensorDict(
            {"joint_torque": part * largest.expand(2, 20), "joint_velocity": torch.zeros(2, 20),
             "target": torch.zeros(2, 20)}, [2]
        )  # fmt: skip
        effort.update(td, moment([True, True]))
    assert effort.table(ENDED)["torque_saturation"].tolist() == [0.5, 0.5]


def test_jerk_of_a_cubic_is_its_third_derivative(make_base):
    """``q = 2 t^3`` in one of 20 joints: 12 rad/s3, and its root mean square over joints."""
    env = make_base(num_envs=1)
    effort = Effort(env)
    for step in range(12):
        target = torch.zeros(1, 20)
        target[0, 3] = 2 * (step * env.control_dt) ** 3
        td = TensorDict(
            {"joint_torque": torch.zeros(1, 20), "joint_velocity": torch.zeros(1, 20),
             "target": target}, [1]
        )  # fmt: skip
        effort.update(td, moment([True]))
    assert effort.table(ENDED)["target_jerk"].item() == pytest.approx(12 / 20**0.5, rel=1e-2)


def test_a_trial_that_was_over_before_the_push_has_no_effort(make_base):
    table = Effort(make_base(num_envs=1)).table(ENDED)
    assert all(value.isnan().all() for value in table.values())
