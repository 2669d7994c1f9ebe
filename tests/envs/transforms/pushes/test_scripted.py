"""Scripted pushes: lists, overlaps, shapes."""

import numpy as np
import pytest
import torch
from torch.testing import assert_close
from torchrl.envs import Transform

from tests.envs.transforms.pushes.test_random import ACTION, wrenches
from zfall.envs.transforms.pushes import ScriptedPush


def scripted(make_task, values: dict, **kwargs):
    return make_task({**ACTION, "push": (ScriptedPush, values)}, **kwargs)


def test_overlapping_pushes_at_two_points_add_up_in_time(make_task):
    push = {"point": ["torso", "pelvis"], "duration": [0.1, 0.06], "time": [0.1, 0.14]}
    env = scripted(make_task, push | {"plan": [[10.0, 0, 0], [0, 5.0, 0]]})
    wrench = wrenches(env, 0.4)
    torso, pelvis = (env.base_env.push_targets[p] for p in ("torso", "pelvis"))
    assert_close(wrench[:, 25:50, torso, 0], torch.full((4, 25), 10.0))
    assert_close(wrench[:, 35:50, pelvis, 1], torch.full((4, 15), 5.0))
    total = 0.004 * wrench.sum((1, 2))[:, :3]
    assert_close(total, torch.tensor([[1.0, 0.3, 0.0]]).expand(4, 3), rtol=1e-5, atol=1e-6)


def test_several_pushes_at_one_point_act_together(make_task):
    push = {"point": ["torso", "torso"], "duration": 0.1, "time": [0.1, 0.12]}
    env = scripted(make_task, push | {"plan": [[4.0, 0, 0], [3.0, 0, 0]]})
    force = wrenches(env, 0.3)[0, :, env.base_env.push_targets["torso"], 0]
    assert_close(force[25:55], torch.tensor([4.0] * 5 + [7.0] * 20 + [3.0] * 5))


def test_measures_of_a_push_follow_from_each_other(make_task):
    """A half sine of peak 20 N for 0.1 s: J = 2/pi x 20 x 0.1, I = J / (m sqrt(g h0))."""
    values = {"point": "torso", "duration": 0.1, "time": 0.0, "plan": [12.0, 0.0, 16.0]}
    env = scripted(make_task, values | {"profile": "half_sine"})
    td = env.reset()
    td["action"] = torch.zeros(4, 20)
    td = env.step(td)["next"]["push"]
    assert_close(td["peak_force"], torch.full((4, 1), 20.0))
    assert_close(td["impulse"], torch.full((4, 1), 2 / torch.pi * 2.0))
    assert_close(td["size"], torch.full((4, 1), 2 / torch.pi * 2.0 / 4.920), rtol=1e-3, atol=0)


class Wind(Transform):
    """Somebody else's force, before the push in the table."""

    def __init__(self, env):
        super().__init__(in_keys_inv=[("push", "wrench")], out_keys_inv=[("push", "wrench")])
        self.wrench = torch.ones(env.num_envs, env.substeps, env.num_bodies, 6)

    def _inv_call(self, tensordict):
        return tensordict.set(("push", "wrench"), self.wrench)


def test_measures_are_of_the_step_whatever_else_acts_on_the_robot(make_task):
    push = {"point": "torso", "duration": 0.08, "time": 0.04, "plan": [10.0, 0, 0]}
    twice = {"a": (ScriptedPush, push), "b": (ScriptedPush, push | {"plan": [5.0, 0, 0]})}
    env = make_task({**ACTION, "wind": (Wind, {}), **twice})
    td, seen = env.reset(), []
    for _ in range(5):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
        seen.append((td["push", "force"][0, 0].item(), td["push", "peak_force"][0].item()))
    np.testing.assert_allclose(seen, [(0, 0), (15, 10), (15, 10), (0, 0), (0, 0)], atol=1e-4)
    (wind,) = (t for t in env.transform if isinstance(t, Wind))
    assert (wind.wrench == 1.0).all()  # its own tensor: what is added to it would act for ever


def test_an_episode_that_begins_anew_gets_its_pushes_again(make_task):
    env = scripted(
        make_task, {"point": "torso", "duration": 0.1, "time": 0.08, "plan": [5.0, 0, 0]}
    )
    td = env.reset()
    for _ in range(5):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
    td["_reset"] = torch.tensor([[True], [False], [True], [False]])
    td = env.reset(td)
    seen = []
    for _ in range(5):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
        seen.append(td["push", "force"][:, 0])
    assert_close(0.04 * torch.stack(seen).sum(0), torch.tensor([0.5, 0.0, 0.5, 0.0]))


@pytest.mark.parametrize(("values", "message"), [
    ({"duration": 0.0}, "duration must be positive"),
    ({"point": ["torso", "pelvis"]}, r"point must fit 4 worlds with 1 pushes, got shape \(2,\)"),
    ({"time": torch.zeros(3)}, r"time must fit 4 worlds with 1 pushes, got shape \(3, 1\)"),
    ({"point": "tail"}, "point must be a push point or a link"),
])  # fmt: skip
def test_bad_values_are_refused(make_base, values, message):
    good = {"point": "torso", "duration": 0.1, "time": 0.1, "plan": [5.0, 0.0, 0.0]}
    with pytest.raises(ValueError, match=message):
        ScriptedPush(make_base(), **(good | values))
