"""A ball carries the momentum of the push whose place it takes."""

import pytest
import torch
from torch.testing import assert_close

from tests.envs.transforms.pushes.test_ball import BALL, fly
from tests.envs.transforms.pushes.test_random import ACTION
from zfall.envs.transforms.pushes import BallPush, ScriptedPush


def pushed(make_task, force, duration=0.01, **more):
    """Three worlds, pushed 0.2 s into the episode, that is in step 5."""
    push = {"point": "pelvis", "duration": duration, "time": 0.2, "plan": force}
    table = {"push": (ScriptedPush, push), "ball": (BallPush, {"flight": 0.4} | more)}
    return make_task({**ACTION, **table}, num_envs=3, ball=BALL)


def test_the_ball_flies_with_the_momentum_of_the_push_to_its_target(make_task):
    """60 N for 10 ms are 0.6 N s, 2 m/s for 0.3 kg. After 0.2 s of 0.4 s it is 0.4 m away, at
    the height g T^2 / 8 = 0.1962 m above its target."""
    seen = fly(pushed(make_task, [0.0, 60.0, 0.0]), 10)
    speed = seen[5]["ball", "velocity"][:, :2]
    assert_close(speed, torch.tensor([[0.0, 2.0]]).expand(3, 2), atol=1e-4, rtol=0)
    offset = seen[9]["ball", "position"] - seen[4]["com_position"]
    expected = torch.tensor([[0.0, -0.4, 0.1962]]).expand(3, 3)
    assert_close(offset, expected, atol=8e-3, rtol=0)


def test_the_push_itself_does_not_act_and_a_world_without_one_sees_no_ball(make_task):
    env = pushed(make_task, torch.tensor([[60.0, 0.0, 0.0], [0.0, 0.0, 0.0], [60.0, 0.0, 0.0]]))
    seen = fly(env, 12)
    flying = seen[6]["ball", "position"][:, :2].norm(dim=-1) < 2.0
    assert flying.tolist() == [True, False, True]
    moved = seen[11]["linear_momentum"] - seen[4]["linear_momentum"]
    assert moved.norm(dim=-1).max() < 0.1  # of the 0.6 N s that the push would have given
    hit = fly(env, 22)[-1]["base_linear_velocity"]
    assert hit[0].norm() > 3 * hit[1].norm()


def test_the_aim_is_above_the_center_of_mass(make_task):
    (low, high) = (pushed(make_task, [60.0, 0.0, 0.0], aim=aim) for aim in (0.0, 0.05))
    heights = [fly(env, 8)[-1]["ball", "position"][:, 2] for env in (low, high)]
    assert_close(heights[1] - heights[0], torch.full((3,), 0.05), atol=1e-3, rtol=0)


def test_a_ball_push_needs_a_ball(make_base):
    with pytest.raises(
        ValueError, match=r"BallPush must have a ball to throw: give base_env\.ball"
    ):
        BallPush(make_base())
    with pytest.raises(ValueError, match="flight must be positive, got 0"):
        BallPush(make_base(ball=BALL), flight=0.0)
