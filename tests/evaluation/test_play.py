"""What is measured of how far a policy gets."""

import math

import pytest
import torch
from hydra.utils import instantiate

from zfall.envs.make import make_env
from zfall.envs.tables import keep
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.starts import ScriptedStart
from zfall.evaluation.play import planned, side_pushes, walk
from zfall.falling.modes import ModeMachine


def test_speed_and_distance_are_those_of_a_flight(make_base):
    """In free fall from 9 m the level velocity stays: a quarter of the worlds face against it."""
    base = make_base(num_envs=64)
    heading = torch.full((64,), math.radians(60.0))
    flip = torch.arange(64) % 4 == 0
    faces = heading + math.pi * flip
    zero = torch.zeros(64)
    start = ScriptedStart(
        base,
        states={
            "base_position": torch.tensor([[1.0, 2.0, 9.0]]).repeat(64, 1),
            "base_orientation": torch.stack([(faces / 2).cos(), zero, zero, (faces / 2).sin()], -1),
            "base_linear_velocity": 0.5 * torch.stack([heading.cos(), heading.sin(), zero], -1),
        },
    )
    env = make_env(base, {"action": JointPositionTarget(base, scale=0.6), "start": start})
    played = walk(env, None, 1.0)
    assert played.figures["fell"] == 0
    assert played.figures["seconds"] == pytest.approx(1.0)
    assert played.figures["forward_velocity"] == pytest.approx(0.5 * (48 - 16) / 64, rel=0.02)
    assert played.figures["distance"] == pytest.approx(0.5 * (1.0 - base.control_dt), rel=0.02)
    assert played.states.shape[1] == played.pushed.force.shape[1] == 4


@pytest.mark.parametrize("kept", [[], ["push"]])
def test_pushes_are_there_if_they_are_kept(compose_config, kept):
    often = ["env.transforms.push.interval=[0.0,0.1]", "num_envs=64"]
    env = instantiate(keep(compose_config(*often).env, kept), training=False)
    forces = walk(env, None, 1.0).pushed.force
    assert (forces != 0).any() == bool(kept)


def test_pushes_come_from_the_four_sides_in_turn(make_base):
    """I = 0.5 is 24.6 N for 0.1 s; world 0 is pushed forward first, then to the left."""
    base = make_base(num_envs=64)
    env = make_env(base, {"action": JointPositionTarget(base, scale=0.6)})
    push = side_pushes(env, [0.5], 10.0)
    assert push.time[0].tolist() == [1.0, 5.0, 9.0]
    size = 0.5 * base.robot.mass * math.sqrt(9.81 * base.robot.com_height) / 0.1
    expected = size * torch.tensor([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0]])
    torch.testing.assert_close(push.plan[0], expected, atol=1e-4, rtol=0)
    torch.testing.assert_close(push.plan[1, 0], expected[1], atol=1e-4, rtol=0)
    first = torch.atan2(push.plan[:, 0, 1], push.plan[:, 0, 0]) % (2 * math.pi)
    apart = first.sort().values.diff()
    torch.testing.assert_close(apart, torch.full((63,), 2 * math.pi / 64), atol=1e-4, rtol=0)
    env.append_transform(push)
    with pytest.raises(ValueError, match="pushes"):
        side_pushes(env, [0.5], 10.0)


def test_a_task_may_say_with_which_pushes_it_is_shown(make_base):
    """Unless sizes are given; a size of 0 is no push."""
    base = make_base(num_envs=64)
    plain, falls = make_env(base, {}), make_env(make_base(num_envs=64), {})
    falls.append_transform(ModeMachine(falls.base_env, back=0.5, rise=0.04))
    assert planned(plain, None, None) == (None, 4.0)
    assert planned(plain, 0.4, 2.0) == ([0.4], 2.0)
    assert planned(falls, None, None) == ([1.25], 10.0)
    assert planned(falls, [0.2, 0.3], None) == ([0.2, 0.3], 10.0)
    assert planned(falls, 0.0, None)[0] is None
    pushed = make_env(make_base(num_envs=64), {})
    for transform in (ModeMachine(pushed.base_env), side_pushes(pushed, [0.4], 10.0)):
        pushed.append_transform(transform)
    assert planned(pushed, None, None)[0] is None  # it has pushes of its own
    assert side_pushes(falls, [1.25], 20.0, 10.0).time[0].tolist() == [1.0, 11.0]


@pytest.mark.parametrize(
    ("sizes", "seconds", "key"), [([], 10.0, "pushes"), ([0.2, 0.4], 5.0, "seconds")]
)
def test_pushes_that_would_not_come_are_refused(make_base, sizes, seconds, key):
    with pytest.raises(ValueError, match=f"^{key} must"):
        side_pushes(make_env(make_base(num_envs=4), {}), sizes, seconds)
