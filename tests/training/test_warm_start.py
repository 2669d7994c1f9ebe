"""A training begins with the weights of another."""

import pytest
import torch
from torch.testing import assert_close

from tests.shell import TINY, run
from zfall import checkpoint
from zfall.policies.load import load_policy
from zfall.training.learner import Learner
from zfall.training.warm_start import warm_start


def trained_in(folder, cfg):
    """A run folder after one update."""
    learner = Learner(cfg)
    learner.learn(learner.collect())
    (folder / "checkpoints").mkdir(parents=True)
    checkpoint.save(folder / "checkpoints" / "last.pt", learner.state_dict())
    return folder


@pytest.fixture
def trained(compose_config, tmp_path):
    return trained_in(tmp_path / "run", compose_config("num_envs=8", "rollout_steps=2"))


def test_the_policy_acts_as_that_run_and_explores_as_configured(trained, compose_config):
    learner = Learner(compose_config("num_envs=8", "rollout_steps=2", "actor.std=0.17", "seed=5"))
    warm_start(learner, str(trained))
    theirs = load_policy(trained).actor
    td = learner.env.fake_tensordict().select("observation")
    td["observation"] = torch.randn(td["observation"].shape)
    for actor in (learner.actor, learner.policy):
        mine, other = actor.get_dist(td.clone()), theirs.get_dist(td.clone())
        assert_close(mine.mean, other.mean, atol=0, rtol=0)
        assert_close(mine.stddev, torch.full_like(mine.stddev, 0.17))
    saved = checkpoint.load(trained / "checkpoints" / "last.pt")["critic"]
    assert all(torch.equal(saved[k], v) for k, v in learner.critic.state_dict().items())


@pytest.mark.parametrize("other", ["num_cells=[32]", "scale=5.0", "activation=tanh"])
def test_a_critic_that_is_configured_otherwise_begins_anew(trained, compose_config, other):
    """In another unit the same weights would say other values."""
    learner = Learner(compose_config("num_envs=8", "rollout_steps=2", f"critic.{other}"))
    before = [p.clone() for p in learner.critic.parameters()]
    warm_start(learner, str(trained))
    assert all(map(torch.equal, before, learner.critic.parameters()))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("env.transforms.action.scale=0.5", "must have the same env.transforms.action.scale, got 0.6 and 0.5"),
        ("actor.num_cells=[32]", "must hold the configured actor"),
        ("actor.activation=tanh", "must have the same actor.activation, got elu and tanh"),
    ],
)  # fmt: skip
def test_a_policy_that_does_not_fit_is_refused(trained, compose_config, given, message):
    learner = Learner(compose_config("num_envs=8", "rollout_steps=2", given))
    with pytest.raises(ValueError, match=message):
        warm_start(learner, str(trained))


def test_a_policy_goes_on_with_more_decisions(trained, compose_config):
    given = ("num_envs=8", "rollout_steps=2", "env.base_env.control_dt=0.02")
    learner = Learner(compose_config(*given))
    warm_start(learner, str(trained))
    theirs = load_policy(trained).actor.state_dict()
    mine = learner.actor.state_dict()
    assert all(torch.equal(theirs[k], mine[k]) for k in theirs if not k.endswith("log_std"))


def test_a_policy_that_prefers_the_other_side_is_refused(compose_config, tmp_path):
    given = ("num_envs=8", "rollout_steps=2", "actor.symmetric=true")
    run = trained_in(tmp_path / "run", compose_config(*given, "actor.handedness=1.0"))
    learner = Learner(compose_config(*given, "actor.handedness=-1.0"))
    with pytest.raises(ValueError, match="must have the same actor.handedness, got 1.0 and -1.0"):
        warm_start(learner, str(run))


def test_a_mixture_with_a_lower_floor_acts_as_before_and_explores_by_as_much_less(
    compose_config, tmp_path
):
    given = ("num_envs=8", "rollout_steps=2", "actor=mlp_mog")
    with_floor = compose_config(*given, "actor.std_range=[0.2,1.0]")
    run_folder = trained_in(tmp_path / "run", with_floor)
    learner = Learner(compose_config(*given, "actor.std_range=[0.05,1.0]", "seed=5"))
    warm_start(learner, str(run_folder))
    theirs = load_policy(run_folder).actor
    td = learner.env.fake_tensordict().select("observation")
    td["observation"] = torch.randn(td["observation"].shape)
    mine, other = learner.actor.get_dist(td.clone()), theirs.get_dist(td.clone())
    assert_close(mine.mean, other.mean, atol=0, rtol=0)
    assert_close(mine.scale, other.scale - 0.15)


def test_from_the_shell_the_training_starts_where_that_run_ended(tmp_path):
    """Steps of length 0 leave the weights where they began: those of the first run."""
    assert run("train", *TINY, f"hydra.run.dir={tmp_path}/first").returncode == 0
    still = ["optimizer.lr=0.0", "scheduler=null", "averaging=0.0", "seed=3"]
    begun = [f"warm_start={tmp_path}/first", f"hydra.run.dir={tmp_path}/second"]
    done = run("train", *TINY, *still, *begun)
    assert done.returncode == 0, done.stderr
    first, second = (
        checkpoint.load(tmp_path / name / "checkpoints" / "last.pt")["policy"]
        for name in ("first", "second")
    )
    weights = [key for key in first if key.endswith(("weight", "bias"))]
    assert len(weights) >= 6
    for key in weights:
        assert_close(second[key], first[key], rtol=0, atol=0)
