"""Where quantities lie in an observation and how they mirror, in the tasks that there are."""

import pytest
import torch
from hydra.utils import instantiate
from torch.testing import assert_close

from zfall.training.learner import Learner
from zfall.training.task_facts import TaskFacts

STACK = "+env.transforms.{}={{_target_: torchrl.envs.CatFrames, N: 3, dim: -1, in_keys: [{}], out_keys: [{}], before: init}}"
STACKED = STACK.format("stack", "observation", "observation")
SIZES = ("num_envs=4", "rollout_steps=4", "minibatches=2")


def facts(cfg) -> TaskFacts:
    return TaskFacts(instantiate(cfg.env), cfg)


def test_a_stack_of_observations_is_known_frame_by_frame(compose_config):
    """By an env that runs: the joints of each frame are the joints there, and so are its images."""
    plain = facts(compose_config("num_envs=4", "env.transforms.noise=null"))
    task = facts(compose_config("num_envs=4", "env.transforms.noise=null", STACKED))
    torch.manual_seed(0)
    steps = task.env.rollout(4, break_when_any_done=False)
    place = task.spans()["joint_position"]
    assert len(place) == 3 * 20
    joints = steps["observation"][:, -1][:, place].unflatten(1, (3, 20))
    assert_close(joints, steps["joint_position"][:, 1:])
    single, stacked = plain.mirror("observation"), task.mirror("observation")
    seen = torch.randn(5, 3, len(single.index))
    assert_close(stacked(seen.flatten(1)), single(seen).flatten(1))


def test_a_stack_under_a_name_of_its_own(compose_config):
    cfg = compose_config("num_envs=4", STACK.format("stack", "observation", "history"))
    task = facts(cfg)
    assert_close(task.mirror("history").index, task.mirror("observation").stacked(3).index)
    assert isinstance(task.spans("observation")["joint_position"], slice)


def test_smoothness_by_name_and_symmetry_of_a_stack_of_observations(compose_config):
    sigma = "auxiliary_losses.caps.sigma={joint_velocity: 0.3}"
    learner = Learner(compose_config(*SIZES, STACKED, "caps=atalante", "symmetry=loss", sigma))
    assert learner.learn(learner.collect())["loss_symmetry"] > 0
    caps = learner.losses.auxiliary["auxiliary_losses.caps"]
    size = learner.env.observation_spec["observation"].shape[-1]
    assert caps.sigma.shape == (size,)
    assert int((caps.sigma > 0).sum()) == 3 * 20
    moved = caps.sigma.unflatten(0, (3, -1)) > 0
    assert (moved == moved[0]).all()


def test_a_vector_that_another_transform_changes_is_none(compose_config):
    norm = "{_target_: torchrl.envs.ObservationNorm, loc: 0.5, scale: 2.0, in_keys: [observation]"
    task = facts(compose_config("num_envs=2", f"+env.transforms.norm={norm}, before: init}}"))
    assert task.spans() == {}
    with pytest.raises(ValueError, match="a mirrored observation must be .* ObservationNorm"):
        task.mirror("observation")


def test_a_quantity_by_itself_mirrors_as_in_a_vector(compose_config):
    task = facts(compose_config("num_envs=2"))
    assert task.mirror("projected_gravity").factor.tolist() == [1.0, -1.0, 1.0]
    with pytest.raises(ValueError, match="a mirrored quantity must be .* got diverged"):
        task.mirror("diverged")


@pytest.mark.parametrize("task", ["push_recovery_realistic", "zeroth_fall"])
def test_symmetry_in_every_task_whose_critic_sees_parameters(compose_config, task):
    cfg = compose_config(*SIZES, f"env={task}", "symmetry=augmentation")
    learner = Learner(cfg)
    means = learner.learn(learner.collect())
    assert all(torch.tensor(list(means.values())).isfinite())
