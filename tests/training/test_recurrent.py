"""Networks with any number of hidden states in every kind of training."""

import copy

import pytest
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch.testing import assert_close
from torchrl.modules import set_recurrent_mode

from tests.recurrent import lstm_actor, shake
from zfall.losses.policy_pass import policy_pass
from zfall.modules.actors import recurrent_keys
from zfall.modules.gru import borrow_memory
from zfall.training.learner import Learner

HERE = "tests.training.test_recurrent."
SIZES = ("num_envs=4", "rollout_steps=8", "epochs=2", "minibatches=2")
SHORT = "env.transforms.limit.seconds=0.2"  # five steps: episodes begin within a batch
WITH = {
    "caps": ("caps=atalante",),
    "symmetry loss": ("symmetry=loss",),
    "augmentation": ("symmetry=augmentation",),
    "all": ("caps=atalante", "symmetry=loss", "burn_in=2", "averaging=0.9"),
}


def of(actor: str, critic: str | None = "lstm_critic") -> list[str]:
    """Overrides that take networks from a place."""
    changes = ["~actor", f"+actor={{_target_: {actor}}}"]
    return changes + ["~critic", f"+critic={{_target_: tests.recurrent.{critic}}}"] * bool(critic)


@pytest.mark.parametrize(
    ("actor", "losses"), [*(("lstm_actor", losses) for losses in WITH), ("two_grus_actor", "all")]
)
def test_it_learns_from_what_it_did_and_is_resumed_bit_by_bit(compose_config, actor, losses):
    """Divergence of 0 from the policy of collection, finite losses, and the same after a resume."""
    cfg = compose_config(*SIZES, SHORT, *of(f"tests.recurrent.{actor}"), *WITH[losses])
    learner = Learner(cfg)
    learner.learn(learner.collect())
    state = copy.deepcopy(learner.state_dict())
    batch = learner.collect()
    assert batch["is_init"][:, 1:].any()
    with torch.no_grad(), set_recurrent_mode(True):
        learner.advantage(batch)
    assert abs(learner.loss(batch.clone())["max_ratio"].item() - 1) < 1e-4
    resumed = Learner(cfg)
    resumed.load_state_dict(state)
    other = resumed.collect()
    for key in (*recurrent_keys(learner.actor), "action"):
        assert torch.equal(other[key], batch[key])
    means = resumed.learn(other)
    smooth, symmetric = ["loss_temporal", "loss_spatial"], ["loss_symmetry"]
    added = {"caps": smooth, "symmetry loss": symmetric, "all": smooth + symmetric}
    assert all(means[key] > 0 for key in added.get(losses, []))
    assert all(torch.tensor(list(means.values())).isfinite())


def test_values_that_follow_a_step_are_those_of_the_memory_it_left(compose_config):
    """An LSTM as critic, stepped by hand over a batch in which episodes end."""
    learner = Learner(compose_config(*SIZES, SHORT, *of("tests.recurrent.lstm_actor")))
    shake(learner.critic, 0.1)
    learner.collect()
    batch = learner.collect()
    memory = {key: batch[key][:, 0] for key in recurrent_keys(learner.critic)}
    with torch.no_grad(), set_recurrent_mode(True):
        learner.advantage(batch)
    for t in range(batch.shape[1]):
        now = batch[:, t].select("observation_critic", "is_init").update(memory)
        with torch.no_grad():
            out = learner.critic(now)
            memory = {key: out["next", key] for key in memory}
            after = batch["next"][:, t].select("observation_critic").update(memory)
            after["is_init"] = torch.zeros_like(now["is_init"])
            value = learner.critic(after)["state_value"]
        assert_close(batch["state_value"][:, t], out["state_value"], atol=1e-5, rtol=0)
        assert_close(batch["next", "state_value"][:, t], value, atol=1e-5, rtol=0)


def without_a_successor(observation_spec, action_spec):
    """Forgets the cell: only one of both hidden states goes on."""
    actor = lstm_actor(observation_spec, action_spec)
    actor.select_out_keys("action", "action_log_prob", ("next", "recurrent_state_actor_h"))
    return actor


def without_successors(observation_spec, action_spec):
    """Forgets both, and would begin anew in every step."""
    actor = lstm_actor(observation_spec, action_spec)
    actor.select_out_keys("action", "action_log_prob")
    return actor


def without_a_beginning(observation_spec, action_spec):
    """A memory of its own making, of which nobody says how it begins."""
    actor = lstm_actor(observation_spec, action_spec)
    counter = TensorDictModule(lambda x: x + 1, ["count"], [("next", "count")])
    return TensorDictSequential(counter, actor)


@pytest.mark.parametrize(
    ("actor", "rule"),
    [
        ("without_a_successor", "actor must write what follows its memory recurrent_state_actor_c"),
        ("without_successors", "actor must read what the env gives, not recurrent_state_actor_h"),
        ("without_a_beginning", "actor must say how its memory count begins, by a module with"),
    ],
)
def test_a_memory_that_cannot_be_carried_is_refused_before_collection(compose_config, actor, rule):
    with pytest.raises(ValueError, match=rule):
        Learner(compose_config(*SIZES, *of(HERE + actor, None), "symmetry=none"))


def test_a_memory_that_is_not_carried_cannot_be_mirrored(compose_config):
    rule = "augmentation: what networks see must be given by the env to be mirrored, recurrent_"
    mirrored = (*of(HERE + "without_successors", None), "symmetry=augmentation")
    with pytest.raises(ValueError, match=rule):
        Learner(compose_config(*SIZES, *mirrored))


def test_sequences_do_not_borrow_from_an_actor_that_lends_nothing(compose_config):
    learner = Learner(compose_config(*SIZES, *of("tests.recurrent.lstm_actor", None)))
    batch = learner.collect().select(*learner.actor.in_keys)
    with pytest.raises(ValueError, match="companions must have a memory of their own"):
        policy_pass(learner.actor, batch, [borrow_memory(batch)])


def test_who_borrows_may_come_first(compose_config):
    """A batch that borrows from its companion, and the same the other way round."""
    learner = Learner(compose_config(*SIZES, SHORT, "actor=gru_gaussian"))
    shake(learner.actor, 0.1)
    batch = learner.collect().select(*learner.actor.in_keys)
    near = batch.clone().set("observation", batch["observation"] + 0.1)
    with torch.no_grad():
        policy, (action,) = policy_pass(learner.actor, batch, [borrow_memory(near)])
        other, (other_action,) = policy_pass(learner.actor, borrow_memory(near), [batch])
    assert_close(other_action, policy.mean)
    assert_close(other.mean, action)
    assert (action - policy.mean).abs().max() > 1e-4
