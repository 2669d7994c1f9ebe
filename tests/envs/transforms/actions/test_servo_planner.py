"""The trapezoidal profile of a servo's firmware."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.transforms.actions import ServoPlanner
from zfall.robots import ZEROTH01
from zfall.robots.servos import servo

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


@pytest.mark.parametrize("register", [50, 254])
@pytest.mark.parametrize("way", [0.1, 0.6, 2.0])
def test_a_step_under_the_register_follows_the_trapezoid(make_base, send, register, way):
    """Within what the set-point moves in one physics step of the continuous profile."""
    servos = dict.fromkeys(ZEROTH01.joints, servo("STS3250", acceleration=register))
    base = make_base(num_envs=1, servos=servos)
    planner = ServoPlanner(base, acceleration=None)
    a, v = register * 100 * torch.pi * 2 / 4096, SPEED  # 0.1534 rad/s2 each
    got = send(planner, (base.stand_position + way).expand(1, 500, 20)) - base.stand_position
    t = torch.arange(1, 501) * DT
    top = min(v, (way * a) ** 0.5)  # speed at the end of the ramp, or in the middle of a triangle
    rise = top / a
    whole = way / top + rise
    up, down = t.clamp_max(rise), (whole - t).clamp(0.0, rise)
    expected = torch.where(t < rise, a * up**2 / 2, a * rise**2 / 2 + top * (t - rise))
    expected = torch.where(t > whole - rise, way - a * down**2 / 2, expected)
    assert (got[0, :, 0] - expected).abs().max() < 1.5 * top * DT
    late = (got[0, :, 0] >= way - 1e-3).int().argmax() - (expected >= way - 1e-3).int().argmax()
    assert abs(int(late)) <= 2
    assert_close(got[0, :, 0], got[0, :, 19], atol=1e-5, rtol=0)


def test_no_ramp_passes_commands_on_and_leaves_other_joints_theirs(make_base, send):
    """A register of 0 is no ramp: only the speed limit holds, if there is one."""
    servos = dict.fromkeys(ZEROTH01.joints, servo("STS3250"))
    servos[ZEROTH01.joints[3]] = servo("STS3250", acceleration=254)
    base = make_base(num_envs=2, servos=servos)
    commands = base.stand_position + 0.3 * torch.randn(2, 40, 20)
    got = send(ServoPlanner(base, velocity=None, acceleration=None), commands)
    free = torch.arange(20) != 3
    assert_close(got[..., free], commands[..., free])
    plain = send(ServoPlanner(base, velocity=100.0, acceleration=254 * 0.15339808), commands)
    assert_close(got[..., 3], plain[..., 3], atol=1e-4, rtol=0)
    step = (base.stand_position + 1.0).expand(2, 40, 20)
    got = send(ServoPlanner(base, acceleration=0.0), step) - base.stand_position
    t = torch.arange(1, 41) * DT
    assert_close(got[0, :, 0], (SPEED * t).clamp_max(1.0), atol=1e-5, rtol=0)


def test_a_ramp_of_servos_that_have_no_register_is_refused(make_base):
    with pytest.raises(ValueError, match="acceleration must be a number, got null"):
        ServoPlanner(make_base(num_envs=1), acceleration=None)
    with pytest.raises(ValueError, match="acceleration must be .*got -1"):
        ServoPlanner(make_base(num_envs=1), acceleration=-1.0)


def test_a_world_ramps_as_it_has_drawn(make_base, send, at_rest):
    """From rest, far from the command, the speed after a second is the acceleration."""
    base = make_base(num_envs=64)
    planner = ServoPlanner(base, velocity=None, acceleration=[10.0, 28.0], param="ramp")
    planner._reset(at_rest(base), at_rest(base))
    shown = planner._step(TensorDict(), TensorDict(batch_size=[64]))["params", "ramp"]
    assert 10.0 <= shown.min() < 11.0
    assert 27.0 < shown.max() <= 28.0
    send(planner, (base.stand_position + 1000.0).expand(64, 250, 20))  # 1 s
    assert_close(planner.speed, shown.expand(-1, 20), atol=0.01, rtol=0)


def test_only_what_is_drawn_is_shown(make_base):
    with pytest.raises(ValueError, match="param must be null where nothing is drawn, got ramp"):
        ServoPlanner(make_base(), param="ramp")
