"""Velocities integrated into targets, and what the servos are told meanwhile."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.transforms.actions import JointVelocityTarget
from zfall.robots import ZEROTH01

ELBOW, SHOULDER = 14, 12  # left


def drive(transform, actions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Targets ``(N, K, J)`` and commands ``(N, K S, J)`` of actions ``(N, K, J)``."""
    num = len(actions)
    start = TensorDict(
        {"joint_position": torch.tensor(ZEROTH01.stand_position).repeat(num, 1)}, [num]
    )
    transform._reset(TensorDict(batch_size=[num]), start)
    steps = [transform._inv_call(TensorDict({"action": a}, [num])) for a in actions.unbind(1)]
    return torch.stack([s["target"] for s in steps], 1), torch.cat([s["control"] for s in steps], 1)


@pytest.mark.parametrize("rate", [None, 250.0, 125.0, 50.0, 25.0])
def test_position_and_velocity_sent_are_those_of_the_closed_form(make_base, rate):
    """Small random velocities, far from the stops: q is the sum of v T, sampled at each tick."""
    base = make_base()
    transform = JointVelocityTarget(base, limit=2.0, rate=rate)
    actions = 0.05 * torch.randn(4, 6, 20)
    target, control = drive(transform, actions)
    velocity = 2.0 * actions
    end = base.stand_position + 0.04 * velocity.cumsum(1)
    free = ((end > base.joint_range[:, 0]) & (end < base.joint_range[:, 1])).all(1)
    assert free.sum() > 60
    tick = 1 / (rate or 250.0)
    time = torch.arange(10) * 0.004
    sampled = torch.floor(time / tick + 1e-6) * tick  # held until the next tick
    ahead = sampled[:, None] + torch.full((20,), 1.346404 / 31.243846)  # damping / stiffness, legs
    expected = (end - 0.04 * velocity)[:, :, None] + velocity[:, :, None] * ahead
    legs = free & (torch.arange(20) < 12)
    assert_close(target.transpose(1, 2)[free], end.transpose(1, 2)[free])
    got = control.unflatten(1, (6, 10)).permute(0, 3, 1, 2)
    assert_close(got[legs], expected.permute(0, 3, 1, 2)[legs])


def test_velocity_sent_is_the_slope_of_the_position_sent_also_at_the_stops(make_base):
    """Every joint runs into its stop and turns around; a servo without damping shows q alone."""
    base = make_base(num_envs=1)
    transform = JointVelocityTarget(base, limit=3.0, rate=125.0)
    actions = torch.cat([torch.full((1, 40, 20), 1.0), torch.full((1, 3, 20), -0.5)], 1)
    _, control = drive(transform, actions)
    plain = JointVelocityTarget(base, limit=3.0, rate=125.0, feedforward=False)
    _, position = drive(plain, actions)
    position, control = position[0, ::2], control[0, ::2]
    slope = (position[1:] - position[:-1]) / 0.008
    velocity = (control - position)[:-1] / base.servo_time_constant
    assert_close(velocity, slope, atol=1e-3, rtol=0)
    low, high = base.joint_range.unbind(-1)
    assert (position <= high).all()
    assert (position >= low).all()
    assert_close(position[200], high)  # 3 rad/s for 1.6 s: enough for the longest way
    assert_close(velocity[199], torch.zeros(20))


def test_without_feedforward_the_command_has_no_jumps(make_base):
    """An action that turns around: q alone, 4 ms x 2 rad/s further at every physics step."""
    base = make_base(num_envs=1)
    transform = JointVelocityTarget(base, limit=2.0, feedforward=False)
    action = torch.zeros(1, 2, 20)
    action[0, :, SHOULDER] = torch.tensor([1.0, -1.0])
    _, control = drive(transform, action)
    way = 0.008 * torch.tensor([*range(10), *range(10, 0, -1)])
    assert_close(control[0, :, SHOULDER], base.stand_position[SHOULDER] + way)


def test_integrator_does_not_wind_up(make_base):
    base = make_base(num_envs=1)
    transform = JointVelocityTarget(base, limit=3.0)
    actions = torch.cat([torch.ones(1, 50, 20), -torch.ones(1, 1, 20)], 1)
    target, _ = drive(transform, actions)
    assert_close(target[0, -1], base.joint_range[:, 1] - 3.0 * 0.04)


def test_action_is_clamped_to_one(make_base):
    base = make_base(num_envs=1)
    transform = JointVelocityTarget(base, limit=1.0)
    target, _ = drive(transform, torch.full((1, 1, 20), -7.0))
    assert_close(target[0, 0, ELBOW], base.stand_position[ELBOW] - 0.04)


def test_limit_of_each_world_acts_there(make_base):
    base = make_base(num_envs=2)
    transform = JointVelocityTarget(base, limit=1.0)
    transform.limit = torch.tensor([1.0, 2.0])
    target, _ = drive(transform, torch.full((2, 1, 20), 0.5))
    way = target[:, 0] - base.stand_position
    assert_close(way[:, SHOULDER], torch.tensor([0.02, 0.04]))


def test_servo_follows_a_moving_target_without_the_lag_of_its_damping(make_base):
    """A hanging arm at 2 rad/s: damping alone would hold it 2 x 0.059 = 0.12 rad behind."""
    behind = {}
    for folded in (True, False):
        base = make_base(num_envs=1, control_dt=0.02)
        start = {"base_position": torch.tensor([[0.0, 0.0, 5.0]])}  # falls freely: no gravity
        td = base.reset(TensorDict({"start": start}, [1]))
        transform = JointVelocityTarget(base, limit=2.0, feedforward=folded)
        transform._reset(TensorDict(batch_size=[1]), td)
        action = torch.zeros(1, 20)
        action[0, SHOULDER] = 0.5
        for _ in range(20):
            command = transform._inv_call(TensorDict({"action": 2 * action}, [1]))
            td = base._step(command)
        behind[folded] = (command["target"] - td["joint_position"])[0, SHOULDER].item()
    assert behind[False] - behind[True] == pytest.approx(2 * 0.0593, rel=0.1)
    assert abs(behind[True]) < 0.025  # what friction, 0.2 of 22.7 N m/rad, and the sampling leave


def test_target_starts_where_the_joints_are_within_their_ranges(make_base):
    base = make_base(num_envs=2)
    transform = JointVelocityTarget(base, limit=1.0)
    at = torch.stack([base.stand_position + 0.1, base.joint_range[:, 1] + 0.1])
    td = transform._reset(TensorDict(batch_size=[2]), TensorDict({"joint_position": at}, [2]))
    assert_close(td["target"][0], at[0].minimum(base.joint_range[:, 1]))
    assert_close(td["target"][1], base.joint_range[:, 1])


def test_partial_reset_puts_only_its_rows_to_the_start(make_task):
    env = make_task({"action": (JointVelocityTarget, {"limit": 1.0})}, num_envs=2)
    td = env.reset()
    td["action"] = torch.full((2, 20), 0.5)
    td = env.step(td)["next"]
    moved = td["target"].clone()
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    assert_close(td["target"][0], env.base_env.stand_position)
    assert_close(td["target"][1], moved[1])
    td["action"] = torch.zeros(2, 20)
    assert_close(env.step(td)["next", "target"], td["target"])
