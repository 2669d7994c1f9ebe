"""The ball flies as balls do, and hits."""

import pytest
import torch
from torch.testing import assert_close

from tests.envs.transforms.pushes.test_random import ACTION
from zfall.envs.transforms.pushes import ThrownBall
from zfall.robots import Ball

BALL = Ball(mass=0.3, radius=0.04)


def thrown(make_task, **more):
    throw = {"speed": [2.0, 2.0], "distance": 1.0, "aim": [0.05, 0.05], "times": [0.2]} | more
    return make_task({**ACTION, "ball": (ThrownBall, throw)}, num_envs=3, ball=BALL)


def fly(env, steps: int) -> list:
    td, seen = env.reset(), []
    for _ in range(steps):
        td["action"] = torch.zeros(3, 20)
        td = env.step(td)["next"]
        seen.append(td)
    return seen


def test_the_flight_is_a_parabola(make_task):
    """0.2 s after the throw: 0.4 m nearer, and lifted by v_z t - g t^2 / 2 with v_z = g / 4."""
    before, *_, after = fly(thrown(make_task), 10)[4:]
    target = before["com_position"] + torch.tensor([0.0, 0.0, 0.05])
    offset = after["ball", "position"] - target
    assert_close(offset[:, :2].norm(dim=-1), torch.full((3,), 0.6), atol=5e-3, rtol=0)
    lift = 9.81 * 0.25 * 0.2 - 0.5 * 9.81 * 0.2**2
    assert_close(offset[:, 2], torch.full((3,), lift), atol=8e-3, rtol=0)


def test_the_ball_hits_and_pushes_the_robot_away_from_where_it_came(make_task):
    seen = fly(thrown(make_task), 20)
    side = seen[10]["ball", "position"][:, :2] - seen[10]["com_position"][:, :2]
    momentum = torch.stack([td["linear_momentum"][:, :2] for td in seen[13:]])
    along = ((momentum - momentum[0]) * side).sum(-1) / side.norm(dim=-1)
    assert (along.amin(0) < -0.15).all()  # of the 0.6 N s that the ball carries


def test_the_ball_waits_out_of_reach_and_returns_there_at_a_reset(make_task):
    env = thrown(make_task)
    seen = fly(env, 8)
    assert (seen[3]["ball", "position"][:, 0] > 10).all()
    td = seen[-1]
    assert (td["ball", "position"][:, 0].abs() < 2).all()
    td["_reset"] = torch.tensor([[True], [False], [False]])
    after = env.reset(td)["ball", "position"][:, 0]
    assert (after > 10).tolist() == [True, False, False]


def test_the_robot_keeps_its_mass_and_its_keys_with_a_ball(make_base):
    with_ball, without = make_base(ball=BALL), make_base()
    assert with_ball.mass == pytest.approx(without.mass)
    one, other = with_ball.reset(), without.reset()
    for key in other.keys():
        assert_close(one[key], other[key])


def test_an_env_without_a_ball_cannot_throw_one(make_base):
    with pytest.raises(
        ValueError, match="ThrownBall must have a ball to throw: give base_env.ball"
    ):
        ThrownBall(make_base(), speed=[1, 2], times=[1.0])
