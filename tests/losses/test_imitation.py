"""Imitation against the KL divergence of Gaussians, step by step with a memory, and in training."""

import copy

import pytest
import torch
from omegaconf import OmegaConf, open_dict
from tensordict import TensorDict
from torch import nn
from torch.distributions import Independent, Normal, kl_divergence
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded

from tests.shell import run
from zfall import checkpoint
from zfall.losses.imitation import ImitationLoss
from zfall.modules.actors import gru_actor, mlp_actor
from zfall.policies.load import POLICIES
from zfall.training.learner import Learner

OBSERVED, JOINTS = 5, 3
SPEC = Composite({"observation": Unbounded((1, OBSERVED))}, shape=(1,))
ACTION = Unbounded((1, JOINTS))


def small_mlp(seed: int) -> nn.Module:
    torch.manual_seed(seed)
    actor = mlp_actor(SPEC, ACTION, num_cells=[8])
    for parameter in actor.parameters():
        nn.init.normal_(parameter, std=0.5)
    return actor


def test_loss_is_the_divergence_of_gaussians_of_the_same_deviation():
    policy, teacher = small_mlp(0), small_mlp(1)
    batch = TensorDict({"observation": torch.randn(50, OBSERVED)}, [50])
    loss = ImitationLoss(policy, teacher, coeff=0.7, std=0.3)(batch)["loss_imitation"]
    one, other = (actor.get_dist(batch.clone()).mean for actor in (policy, teacher))
    divergence = kl_divergence(Independent(Normal(other, 0.3), 1), Independent(Normal(one, 0.3), 1))
    assert_close(loss, 0.7 * divergence.mean())
    assert loss > 0.1


def test_a_teacher_is_shown_the_vector_that_it_sees():
    policy, teacher = small_mlp(0), small_mlp(1)
    seen, more = torch.randn(50, OBSERVED), torch.randn(50, OBSERVED)
    batch = TensorDict({"observation": seen, "observation_critic": more}, [50])
    module = ImitationLoss(policy, teacher, sees="observation_critic", std=0.5)
    assert module.in_keys == ["observation", "observation_critic"]
    mean = policy.get_dist(TensorDict({"observation": seen}, [50])).mean
    shown = teacher.get_dist(TensorDict({"observation": more}, [50])).mean
    expected = (mean - shown).square().sum(-1).mean() / (2 * 0.25)
    assert_close(module(batch)["loss_imitation"], expected)


MORE = "env.transforms.observation.keys=${env.transforms.observation_critic.keys}"
TASK = ("num_envs=4", "rollout_steps=4", "epochs=1", "minibatches=1")
IMITATION = "auxiliary_losses.imitation"


@pytest.fixture(scope="module")
def one_who_sees_more(tmp_path_factory):
    """A run whose policy sees what the critic does."""
    folder = tmp_path_factory.mktemp("teacher")
    done = run("train", *TASK, MORE, "env.transforms.observation.measured=false",
               "total_frames=16", "showcase=null", f"hydra.run.dir={folder}")  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize("symmetry", ["none", "augmentation"])
def test_a_teacher_may_see_more_than_its_pupil(compose_config, one_who_sees_more, symmetry):
    given = ["imitation=teacher", f"{IMITATION}.teacher={one_who_sees_more}",
             f"{IMITATION}.sees=observation_critic", f"symmetry={symmetry}"]  # fmt: skip
    learner = Learner(compose_config(*TASK, *given))
    assert learner.learn(learner.collect())["loss_imitation"] > 0


@pytest.mark.parametrize(
    ("overrides", "rule"),
    [
        ([], r"must have the same env.transforms.observation.measured, got False and True"),
        ([f"{IMITATION}.sees=observation_teacher"], r"this run must have a vector observation_teacher in its env, has observation_critic, obs"),
        (
            [f"{IMITATION}.sees=observation_critic", "env.transforms.observation_critic.keys=[target]"],
            r"env.transforms.observation.keys \(of this run that of observation_critic\), got",
        ),
    ],
)  # fmt: skip
def test_what_a_teacher_is_shown_must_be_what_it_saw(
    compose_config, one_who_sees_more, overrides, rule
):
    given = ["imitation=teacher", f"{IMITATION}.teacher={one_who_sees_more}", "symmetry=none"]
    with pytest.raises(Exception, match=rule):
        Learner(compose_config(*TASK, *given, *overrides))


def test_what_a_teacher_is_shown_is_mirrored_with_the_rest(compose_config, one_who_sees_more):
    """Of each row either all vectors are mirrored or none."""
    given = ["imitation=teacher", f"{IMITATION}.teacher={one_who_sees_more}"]
    cfg = compose_config(*TASK, *given, f"{IMITATION}.sees=more", "symmetry=augmentation")
    critic = cfg.env.transforms.observation_critic
    with open_dict(cfg):
        cfg.env.transforms.more = OmegaConf.merge(critic, {"out_key": "more"})
    learner = Learner(cfg)
    batch = learner.collect().reshape(-1)
    seen = learner.losses.augmentation(batch)
    rows = seen["mirrored"].reshape(-1)
    assert 0 < rows.sum() < len(rows)
    assert torch.equal(seen["more"], seen["observation_critic"])
    same = (seen["more"] == batch["more"]).all(-1)
    assert torch.equal(same, ~rows)
    assert learner.learn(learner.collect())["loss_imitation"] > 0


def test_gradient_is_that_of_the_mean_alone_and_the_teacher_has_none():
    policy, teacher = small_mlp(0), small_mlp(1)
    module = ImitationLoss(policy, teacher)
    batch = TensorDict({"observation": torch.randn(50, OBSERVED)}, [50])
    module(batch)["loss_imitation"].backward()
    still = {name for name, value in policy.named_parameters() if value.grad is None}
    assert still == {name for name, _ in policy.named_parameters() if "log_std" in name}
    assert all(value.grad is None for value in teacher.parameters())
    ours = {value.data_ptr() for value in policy.parameters()}
    assert {value.data_ptr() for value in module.parameters()} <= ours


def test_a_recurrent_policy_is_followed_through_its_sequences():
    teacher = small_mlp(1)
    torch.manual_seed(2)
    policy = gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2, components=2)
    for parameter in policy.parameters():
        nn.init.normal_(parameter, std=0.5)
    hidden, rows, errors = torch.zeros(4, 2, 8), [], []
    for step in range(6):
        init = torch.tensor([[step == 0], [step in (0, 3)], [step == 0], [step in (0, 2, 5)]])
        td = TensorDict({"observation": torch.randn(4, OBSERVED), "is_init": init}, [4])
        td["recurrent_state_actor"] = torch.where(init[:, None], 0.0, hidden)
        rows.append(td.clone())
        shown = TensorDict({"observation": td["observation"]}, [4])
        with torch.no_grad():
            mean = policy.get_dist(td.clone()).mean
            errors.append(mean - teacher.get_dist(shown).mean)
            hidden = policy(td)["next", "recurrent_state_actor"]
    loss = ImitationLoss(policy, teacher, std=0.5)(torch.stack(rows, 1))["loss_imitation"]
    expected = torch.stack(errors).square().sum(-1).mean() / (2 * 0.25)
    assert_close(loss, expected, rtol=1e-4, atol=0)


@pytest.mark.parametrize("actor", [pytest.param("gru_mog", marks=pytest.mark.slow), "mlp_gaussian"])
def test_a_pupil_comes_closer_to_its_teacher(compose_config, actor):
    """Within some updates, in states of its own, with PPO's loss beside."""
    learner = Learner(
        compose_config(
            "experiment=best", f"actor={actor}", "imitation=teacher", "symmetry=none",
            "num_envs=32", "rollout_steps=8", "auxiliary_share=1.0", "scheduler=null",
            "optimizer.lr=0.001",
        )
    )  # fmt: skip
    errors = [learner.learn(learner.collect())["loss_imitation"] for _ in range(12)]
    assert sum(errors[-3:]) < 0.6 * sum(errors[:3])


@pytest.mark.parametrize(
    ("overrides", "rule"),
    [
        (["experiment=quickstart"], r"best and this run must have the same env.transforms"),
        (["auxiliary_losses.imitation.teacher=nobody"], r"teacher must be a run folder, or one of"),
        (["auxiliary_losses.imitation.teacher=null"], r"imitation.teacher must be text, got null"),
        (["auxiliary_losses.imitation.teacher=kneel"], r"must see the observation alone, .* mode"),
        (["auxiliary_losses.imitation.std=0"], r"imitation.std must be positive and finite, got 0"),
        (["auxiliary_losses.imitation.coeff=-1"], r"coeff must be finite and not negative, got -1"),
        (["auxiliary_losses.imitation.coeff=nan"], r"imitation.coeff must be a number, got nan"),
    ],
)
def test_bad_teachers_are_named(compose_config, overrides, rule):
    given = ["experiment=best", "imitation=teacher", "num_envs=2", "minibatches=1", *overrides]
    with pytest.raises(Exception, match=rule):
        Learner(compose_config(*given))


def test_a_run_goes_on_only_with_the_teacher_it_began_with(compose_config, tmp_path):
    """The same gives the same loss; weights that changed on disk are found out."""
    folder = tmp_path / "checkpoints"
    folder.mkdir()
    content = checkpoint.load(POLICIES / "best.pt")
    checkpoint.save(folder / "last.pt", content)
    given = ["experiment=best", "imitation=teacher", "num_envs=4", "rollout_steps=4", "epochs=1",
             "minibatches=1", f"auxiliary_losses.imitation.teacher={tmp_path}"]  # fmt: skip
    first = Learner(compose_config(*given))
    state = copy.deepcopy(first.state_dict())
    expected = first.learn(first.collect())["loss_imitation"]
    second = Learner(compose_config(*given))
    second.load_state_dict(state)
    assert second.learn(second.collect())["loss_imitation"] == expected
    name = next(key for key in content["policy"] if key.endswith("weight"))
    content["policy"][name] += 0.1
    checkpoint.save(folder / "last.pt", content)
    changed = Learner(compose_config(*given))
    with pytest.raises(ValueError, match="auxiliary_losses.imitation.teacher must be what it was"):
        changed.load_state_dict(state)


def test_a_teacher_with_memory_is_refused():
    recurrent = gru_actor(SPEC, ACTION, hidden_size=8)
    with pytest.raises(ValueError, match="teacher must be a policy without memory"):
        ImitationLoss(small_mlp(0), recurrent)
