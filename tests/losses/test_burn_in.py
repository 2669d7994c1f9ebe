"""Memories are refreshed with the present weights."""

import torch
from torch.testing import assert_close
from torchrl.modules import set_recurrent_mode

from recipes.learner import Learner
from zfall.losses.burn_in import burnt_in


def test_burn_in_starts_from_the_memory_of_the_present_weights(compose_config):
    """After the weights have moved: what a replay of the whole sequence has from step 3 on."""
    sizes = ("num_envs=6", "rollout_steps=8", "actor=gru_mog", "critic=gru")
    learner = Learner(compose_config(*sizes, "env.transforms.limit.seconds=0.2"))
    learner.collect()
    batch = learner.collect().select(*learner._learned)
    with torch.no_grad():
        for parameter in learner.parameters:
            parameter.add_(0.05 * torch.randn_like(parameter))
    rest = burnt_in(batch, [learner.actor, learner.critic], 3)
    assert rest.shape == (6, 5)
    for network, out in ((learner.actor, "loc"), (learner.critic, "state_value")):
        with torch.no_grad(), set_recurrent_mode(True):
            if out == "loc":
                whole, part = (network.get_dist(td.clone()).mean for td in (batch, rest))
                stale = network.get_dist(batch[:, 3:].clone()).mean
            else:
                whole, part = (network(td.clone())[out] for td in (batch, rest))
                stale = network(batch[:, 3:].clone())[out]
        assert_close(part, whole[:, 3:], atol=1e-5, rtol=1e-5)
        assert (stale - whole[:, 3:]).abs().max() > 1e-4
    unmoved = batch[:, 3:]
    assert torch.equal(rest["action"], unmoved["action"])
