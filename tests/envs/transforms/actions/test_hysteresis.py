"""Loops worked out by hand."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs import TransformedEnv

from zfall.envs.transforms.actions import Backlash, Deadband, JointPositionTarget
from zfall.robots import ZEROTH01
from zfall.robots.servos import STS3215, STS3250


def loop(base, send, transform, ways: list[float]) -> torch.Tensor:
    """Response of one joint to a course of commands, both as ways from the reference."""
    start = base.stand_position
    commands = start + torch.tensor(ways)[None, :, None].expand(1, -1, 20)
    got = send(transform, commands) - start
    assert_close(got, got[..., :1].expand_as(got), atol=1e-6, rtol=0)
    return got[0, :, 15]


def test_backlash_takes_up_the_play_at_every_turn(make_base, send):
    base = make_base(num_envs=1, control_dt=0.02)
    # Play 0.2: it follows 0.1 behind, and stands still for 0.2 after a turn.
    course = [0.0, 0.1, 0.2, 0.5, 0.4, 0.3, 0.2, 0.0, -0.5, -0.4, -0.3, -0.2, 0.0, 0.05, 0.3]
    expected = [0.0, 0.0, 0.1, 0.4, 0.4, 0.4, 0.3, 0.1, -0.4, -0.4, -0.4, -0.3, -0.1, -0.05, 0.2]
    got = loop(base, send, Backlash(base, width=0.2), course)
    assert_close(got, torch.tensor(expected), atol=1e-6, rtol=0)


def test_deadband_ignores_small_changes_until_they_add_up(make_base, send):
    base = make_base(num_envs=1, control_dt=0.02)
    course = [0.05, 0.09, 0.11, 0.15, 0.2, 0.22, 0.13, 0.11, 0.5, 0.41, 0.39, 0.3, 0.28, 0.28, 0.28]
    expected = [
        0.0,
        0.0,
        0.11,
        0.11,
        0.11,
        0.22,
        0.22,
        0.11,
        0.5,
        0.5,
        0.39,
        0.39,
        0.28,
        0.28,
        0.28,
    ]
    got = loop(base, send, Deadband(base, width=0.1), course)
    assert_close(got, torch.tensor(expected), atol=1e-6, rtol=0)


def test_without_width_the_command_passes(make_base, send):
    base = make_base(num_envs=2)
    commands = torch.randn(2, 20, 20)
    for cls in (Backlash, Deadband):
        assert torch.equal(send(cls(base, width=0.0), commands), commands)


def test_play_is_drawn_for_each_episode_and_shown(make_task):
    env = make_task(
        {
            "action": (JointPositionTarget, {"scale": 0.6}),
            "backlash": (Backlash, {"width": [0.01, 0.03], "param": "backlash"}),
        },
        num_envs=256,
    )
    first = env.reset()["params", "backlash"].clone()
    assert first.shape == (256, 1)
    assert 0.01 <= first.min() < 0.0105
    assert 0.0295 < first.max() <= 0.03
    assert abs(first.mean() - 0.02) < 3 * 0.02 / (12 * 256) ** 0.5  # of a uniform distribution
    shown = env.rollout(3)["next", "params", "backlash"]
    assert (shown == shown[:, :1]).all()
    assert not torch.equal(shown[:, 0], first)


def test_a_world_has_the_play_that_it_shows(make_base, send, at_rest):
    """A command that turns around by the play moves nothing; by more, the rest of it."""
    base = make_base(num_envs=8, control_dt=0.02)
    backlash = Backlash(base, width=[0.01, 0.03])
    backlash._reset(at_rest(base), at_rest(base))
    play = backlash.drawn[:, :, None]
    way = torch.tensor([0.5, 0.0, 0.0, 0.0, 0.0])[None, :, None]
    back = torch.tensor([0.0, 1.0, 2.0, 2.0, 2.0])[None, :, None] * play
    got = send(backlash, base.stand_position + way.cumsum(1) - back)
    moved = got - base.stand_position
    assert_close(moved[:, 0], 0.5 - play[:, 0].expand(-1, 20) / 2, atol=1e-5, rtol=0)
    assert_close(moved[:, 1], moved[:, 0], atol=1e-5, rtol=0)
    assert_close(moved[:, 0] - moved[:, 2], play[:, 0].expand(-1, 20), atol=1e-5, rtol=0)


def test_bounds_of_the_play_must_be_in_order(make_base):
    for width, rule in (([0.02, 0.01], "have the smaller number first"), ([-1, 1], "not be neg")):
        with pytest.raises(ValueError, match=f"width must {rule}.*got"):
            Backlash(make_base(), width=width)


@pytest.mark.parametrize("servo", [STS3215, STS3250])
def test_backlash_is_play_at_the_joint(make_base, servo):
    """From below and from above the joint comes to rest at two places, the play apart.

    Dry friction would hold it elsewhere, and the robot floats, so that nothing loads the joint.
    """
    base = make_base(num_envs=1, servos=dict.fromkeys(ZEROTH01.joints, servo))
    base.simulation.model.opt.gravity[:] = 0
    base.set_physics_params(TensorDict({"joint_friction_loss": torch.zeros(1, 20)}, [1]))
    env = TransformedEnv(base, Backlash(base, width=servo.backlash))
    start = torch.zeros(1, 3).index_fill_(1, torch.tensor([2]), 2.0)  # in the air [m]
    td = env.reset(TensorDict({("start", "base_position"): start}, [1]))
    joint, rest = ZEROTH01.joints.index("left_gripper_roll"), []
    for from_where in (0.0, 0.4):
        for angle, steps in ((from_where, 20), (0.2, 30)):
            for _ in range(steps):
                target = base.stand_position[None].clone()
                target[0, joint] = angle
                td = env.step(td.set("target", target))["next"]
        rest.append(td["joint_position"][0, joint].item())
    assert rest[1] - rest[0] == pytest.approx(servo.backlash, rel=0.02)
