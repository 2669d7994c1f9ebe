"""Kicks change the velocity by what they say, when they say."""

import torch
from torch.testing import assert_close

from tests.envs.transforms.pushes.test_random import ACTION
from zfall.envs.transforms.pushes import VelocityKick


def test_kick_moves_the_whole_robot(make_task):
    """In the air without gravity the momentum is mass x kick, and stays."""
    kick = {"velocity": [0.5, 0.5], "times": [0.08], "direction": [0, 1, 0]}
    env = make_task({**ACTION, "kick": (VelocityKick, kick)}, num_envs=2)
    base = env.base_env
    base.simulation.model.opt.gravity[:] = 0
    td = env.reset()
    base.simulation.qpos[:, 2] = 2.0
    momenta = []
    for _ in range(5):
        td["action"] = torch.zeros(2, 20)
        td = env.step(td)["next"]
        momenta.append(td["linear_momentum"])
    before, after = torch.stack(momenta[:2]), torch.stack(momenta[2:])
    assert before.norm(dim=-1).max() < 1e-4
    expected = 3.3494 * torch.tensor([0.0, 0.5, 0.0]).expand_as(after)
    assert_close(after, expected, rtol=1e-3, atol=2e-3)


def test_kicks_come_at_their_times_and_only_then(make_task):
    kick = {"velocity": [0.1, 0.2], "times": [0.08, 0.21]}
    env = make_task({**ACTION, "kick": (VelocityKick, kick)})
    td, seen = env.reset(), []
    for _ in range(10):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
        seen.append(td["push", "velocity_kick"].norm(dim=-1))
    when = (torch.stack(seen) > 0).nonzero()[:, 0].unique().tolist()
    assert when == [2, 5]  # in the steps that begin at 0.08 s and at 0.20 s
    size = torch.stack(seen)[when]
    assert ((size > 0.0999) & (size < 0.2001)).all()


def test_two_kicks_add_up(make_task):
    one = {"velocity": [0.3, 0.3], "times": [0.0], "direction": [1, 0, 0]}
    two = {"velocity": [0.1, 0.1], "times": [0.0], "direction": [0, 1, 0]}
    env = make_task({**ACTION, "one": (VelocityKick, one), "two": (VelocityKick, two)})
    td = env.reset()
    for expected in ([0.3, 0.1, 0.0], [0.0, 0.0, 0.0]):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
        assert_close(td["push", "velocity_kick"], torch.tensor([expected] * 4))
