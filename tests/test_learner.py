"""Collecting and learning."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.modules import set_recurrent_mode

from recipes.learner import Learner


@pytest.fixture(params=["mlp_gaussian", "mlp_mog", "gru_mog"])
def learner(request, compose_config) -> Learner:
    """After two updates, with pushes and resets all the time."""
    learner = Learner(
        compose_config(
            "num_envs=16", "rollout_steps=16", f"actor={request.param}",
            "env.transforms.limit.seconds=0.3", "env.transforms.push.interval=[0.0,0.1]",
        )
    )  # fmt: skip
    for _ in range(2):
        learner.learn(learner.collect())
    return learner


def test_policy_has_not_moved_between_collecting_and_learning(learner):
    """Ratios of 1 across resets, with hidden states and normaliser as they were."""
    batch = learner.collect()
    assert batch["next", "done"][:, :-1].any()
    with torch.no_grad(), set_recurrent_mode(True):
        learner.advantage(batch)
    out = learner.loss(batch)
    assert abs(out["kl_approx"].item()) < 1e-6
    assert abs(out["max_ratio"].item() - 1) < 1e-4


def test_advantages_are_those_of_a_plain_loop(compose_config):
    """delta = r + gamma V(next) (0 if terminated); summed backwards with gamma lambda until done."""
    learner = Learner(
        compose_config("num_envs=8", "rollout_steps=12", "actor.std=1.0", "env.transforms.limit.seconds=0.12",
                       "env.transforms.terminations.conditions.tilt.angle=0.1")
    )  # fmt: skip
    batch = learner.collect()
    assert batch["next", "terminated"].any()
    assert batch["next", "truncated"].any()
    gamma, lmbda = learner.cfg.loss.gamma, learner.cfg.loss.lmbda
    with torch.no_grad():
        learner.advantage(batch)
        value = learner.critic(batch.select("observation_critic"))["state_value"]
        after = learner.critic(batch["next"].select("observation_critic"))["state_value"]
    expected, running = torch.zeros_like(value), torch.zeros(8, 1)
    for t in reversed(range(12)):
        step = batch["next"][:, t]
        delta = step["reward"] + gamma * after[:, t] * ~step["terminated"] - value[:, t]
        running = delta + gamma * lmbda * running * ~step["done"]
        expected[:, t] = running
    assert_close(batch["advantage"], expected, atol=1e-5, rtol=1e-5)


def test_every_parameter_learns(learner):
    before = {name: p.clone() for name, p in learner.actor.named_parameters()}
    learner.learn(learner.collect())
    still = [name for name, p in learner.actor.named_parameters() if torch.equal(p, before[name])]
    assert not still


def test_partial_reset_of_the_whole_task_leaves_the_other_rows_alone(compose_config):
    learner = Learner(compose_config("num_envs=6"))
    learner.collect()
    td = learner.carrier.clone()
    rows = torch.tensor([[True], [False]] * 3)
    td["_reset"] = rows
    after = learner.env.reset(td)
    for key, value in after.items(True, True):
        if key in td.keys(True, True) and key != "_reset":
            assert torch.equal(value[1::2], td[key][1::2]), key


def test_policy_is_the_running_average_of_the_actor(compose_config):
    """After actors a, b, c: first a, then 0.8 a + 0.2 b, then 0.8 of that + 0.2 c."""
    sizes = ("num_envs=8", "rollout_steps=4", "epochs=1", "minibatches=1", "averaging=0.8")
    learner = Learner(compose_config(*sizes))
    expected: dict[str, torch.Tensor] = {}
    for _ in range(3):
        learner.learn(learner.collect())
        for name, value in learner.actor.named_parameters():
            before = expected.get(name, value.detach())
            expected[name] = 0.8 * before + 0.2 * value.detach()
    for name, value in learner.policy.named_parameters():
        assert_close(value.detach(), expected[name])
    buffers = dict(learner.actor.named_buffers())
    for name, value in learner.policy.named_buffers():  # the normaliser is that of the actor
        assert torch.equal(value, buffers[name])
    assert any(
        not torch.equal(a, b)
        for a, b in zip(learner.policy.parameters(), learner.actor.parameters(), strict=True)
    )
