"""Quantities over time."""

import torch
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.windows import LastAction


def test_last_action_is_the_one_before_and_zero_after_a_reset(make_base):
    base = make_base(num_envs=2)
    env = make_env(base, {"action": JointPositionTarget(base, scale=1.0), "last": LastAction()})
    check_env_specs(env)
    td = env.reset()
    assert not td["last_action"].any()
    first, second = torch.full((2, 20), 0.1), torch.full((2, 20), 0.2)
    td["action"] = first
    td = env.step(td)["next"]
    assert torch.equal(td["last_action"], first)
    first.fill_(9.0)  # the caller's own, to be used again
    assert torch.equal(td["last_action"], torch.full((2, 20), 0.1))
    td["action"] = second
    td = env.step(td)["next"]
    assert torch.equal(td["last_action"], second)
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    assert torch.equal(td["last_action"][0], torch.zeros(20))
    assert torch.equal(td["last_action"][1], second[1])
