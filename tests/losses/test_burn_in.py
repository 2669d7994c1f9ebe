"""Memories are refreshed with the present weights."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.modules import set_recurrent_mode

from zfall.losses.burn_in import burnt_in
from zfall.training.learner import Learner

OURS = ("actor=gru_mog", "critic=gru")
OF_TORCHRL = ("~actor", "+actor={_target_: tests.recurrent.lstm_actor, num_layers: 2}",
              "~critic", "+critic={_target_: tests.recurrent.lstm_critic}")  # fmt: skip


@pytest.mark.parametrize("cut", [2, 3])
@pytest.mark.parametrize("networks", [OURS, OF_TORCHRL], ids=["GRU", "LSTM"])
def test_burn_in_starts_from_the_memory_of_the_present_weights(compose_config, cut, networks):
    """After the weights have moved: what a replay of the whole sequence has from the cut on.

    Episodes of five steps begin at steps 2 and 7 of the batch: at the cut itself, or before it.
    """
    sizes = ("num_envs=6", "rollout_steps=8", "statistics_batches=0")
    learner = Learner(compose_config(*sizes, *networks, "env.transforms.limit.seconds=0.2"))
    learner.collect()
    batch = learner.collect().select(*learner._learned)
    with torch.no_grad():
        for parameter in learner.parameters:
            parameter.add_(0.05 * torch.randn_like(parameter))
    assert batch["is_init"][:, [2, 7]].all()
    rest = burnt_in(batch, [learner.actor, learner.critic], cut)
    assert rest.shape == (6, 8 - cut)
    for network, out in ((learner.actor, "loc"), (learner.critic, "state_value")):
        with torch.no_grad(), set_recurrent_mode(True):
            if out == "loc":
                whole, part = (network.get_dist(td.clone()).mean for td in (batch, rest))
                stale = network.get_dist(batch[:, cut:].clone()).mean
            else:
                whole, part = (network(td.clone())[out] for td in (batch, rest))
                stale = network(batch[:, cut:].clone())[out]
        assert_close(part, whole[:, cut:], atol=1e-5, rtol=1e-5)
        if cut == 3:  # an episode that begins with the cut has nothing to refresh
            assert (stale - whole[:, cut:]).abs().max() > 1e-4
    unmoved = batch[:, cut:]
    assert torch.equal(rest["action"], unmoved["action"])
