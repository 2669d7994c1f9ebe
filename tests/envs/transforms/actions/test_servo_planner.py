"""The trapezoidal profile of a servo's firmware."""

import pytest
import torch
from torch.testing import assert_close

from zfall.envs.transforms.actions import ServoPlanner

DT, SPEED, ACCELERATION = 0.004, 5.0, 39.0


def test_target_is_reached_in_the_time_of_the_trapezoid_and_never_passed(make_base, send):
    """Ways from 1 mrad, a triangle in speed, to 3 rad, where the speed limit holds for most."""
    base = make_base(num_envs=8)
    ways = torch.tensor([0.001, 0.01, 0.1, 0.3, 0.641, 1.0, 2.0, 3.0])
    signs = torch.where(torch.arange(20) % 2 == 0, 1.0, -1.0)
    way = ways[:, None] * signs
    start = base.stand_position
    got = send(ServoPlanner(base), (start + way)[:, None].expand(-1, 250, -1)) - start
    share = got / way[:, None]
    assert share.max() < 1.0 + 2e-4  # float32 of angles up to 3 rad, against 1 mrad
    for world, length in enumerate(ways.tolist()):
        fast = length > SPEED**2 / ACCELERATION
        time = length / SPEED + SPEED / ACCELERATION if fast else 2 * (length / ACCELERATION) ** 0.5
        arrived = (1.0 - share[world]).abs() < 1e-3
        first = arrived.int().argmax(0) + 1  # physics steps
        assert (first * DT >= time - 0.1 * time - DT).all()
        assert (first * DT <= time + 2 * DT).all()
        assert arrived[int(time / DT) + 3 :].all()


def test_limits_hold_for_any_command(make_base, send):
    base = make_base(num_envs=16)
    commands = base.stand_position + torch.randn(16, 30, 20).repeat_interleave(10, 1)
    got = send(ServoPlanner(base), commands).double()
    speed = (got[:, 1:] - got[:, :-1]) / DT  # mean of two successive speeds
    assert speed.abs().max() <= SPEED + 1e-3
    assert speed.abs().max() > 0.9 * SPEED
    change = (speed[:, 1:] - speed[:, :-1]) / DT
    assert change.abs().max() <= ACCELERATION + 0.1  # float32 of the angles
    assert change.abs().max() > 0.9 * ACCELERATION


def test_command_within_the_braking_distance_is_passed_and_come_back_to(make_base, send):
    """From full speed v the set-point needs v^2 / (2 a) = 0.32 rad to stop."""
    base = make_base(num_envs=1)
    planner = ServoPlanner(base)
    start = base.stand_position
    send(planner, (start + 10.0).expand(1, 100, 20))
    assert_close(planner.speed, torch.full((1, 20), SPEED))
    here = planner.position.clone()
    got = send(planner, here[:, None].expand(1, 300, 20)) - here[:, None]
    passed = SPEED**2 / (2 * ACCELERATION)
    assert_close(got.amax(1), torch.full((1, 20), passed), atol=3e-3, rtol=0)
    assert got.amin() > -1e-4  # no second swing
    assert_close(got[:, -1], torch.zeros(1, 20), atol=1e-5, rtol=0)


@pytest.mark.parametrize("physics_dt", [0.001, 0.005])
def test_set_point_rests_on_a_still_command(make_base, send, physics_dt):
    base = make_base(num_envs=2, control_dt=0.02, physics_dt=physics_dt)
    command = base.stand_position + 0.5 * torch.randn(2, 1, 20)
    got = send(ServoPlanner(base), command.expand(-1, round(1.0 / physics_dt), -1))
    last = got[:, -20:]
    assert_close(last, command.expand_as(last), atol=1e-6, rtol=0)
