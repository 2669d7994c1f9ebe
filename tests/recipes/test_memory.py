"""Recurrent PPO learns what only a memory can hold."""

import pytest
import torch
from torchrl.envs import ExplorationType, set_exploration_type

from tests import latency_task
from tests.memory_task import STEPS
from zfall.training.learner import Learner


def error_at_the_end(learner: Learner) -> float:
    """Mean squared error of the policy without exploration, when it is asked."""
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = learner.env.rollout(STEPS, learner.actor, break_when_any_done=False)
    return -td["next", "reward"][:, -1].mean().item()


@pytest.mark.parametrize(("actor", "updates"), [("gru_mog", 60), ("mlp_gaussian", 20)])
def test_a_direction_shown_once_is_known_a_second_later_by_a_memory_alone(
    compose_config, actor, updates
):
    """Without memory the least error is 1, that of the action 0."""
    cfg = compose_config(
        "num_envs=64", f"rollout_steps={STEPS}", "epochs=4", "minibatches=2", f"actor={actor}",
        "critic.num_cells=[32]", "loss.lmbda=0.0", "optimizer.lr=2e-3", "scheduler=null",
        "symmetry=none", "statistics_batches=0",
    )  # fmt: skip
    if actor == "gru_mog":
        cfg.actor.hidden_size, cfg.actor.components, cfg.actor.memory_steps = 16, 0, STEPS
    cfg.env = {"_target_": "tests.memory_task.make_env", "num_envs": 64}
    learner = Learner(cfg)
    for _ in range(updates):
        learner.learn(learner.collect())
    error = error_at_the_end(learner)
    assert error < 0.2 if actor == "gru_mog" else error > 0.9


def lateness(compose_config, seed: int, memory: bool) -> float:
    """What is left of a trained policy's error in the last two seconds of an episode, squared."""
    cfg = compose_config(
        f"seed={seed}", "num_envs=128", "rollout_steps=25", "actor=gru_gaussian",
        "actor.encoder_cells=[64]", "actor.num_cells=[64]", "actor.hidden_size=32",
        "actor.memory_steps=50", "critic.num_cells=[64,64]", "optimizer.lr=3e-3", "scheduler=null",
        "loss.gamma=0.95", "symmetry=none",
    )  # fmt: skip
    cfg.env = {"_target_": "tests.latency_task.make_env", "num_envs": 128, "memory": memory}
    learner = Learner(cfg)
    for _ in range(80):
        learner.learn(learner.collect())
    torch.manual_seed(99)  # the same latencies and announcements for all
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        td = learner.env.rollout(latency_task.STEPS, learner.policy, break_when_any_done=False)
    return -td["next", "reward"][:, 25:].mean().item()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_only_a_memory_knows_how_late_commands_arrive(compose_config, seed):
    """The same network whose memory is put back to 0 in every step has to guess."""
    kept, lost = (lateness(compose_config, seed, memory) for memory in (True, False))
    print(f"seed {seed}: squared error {kept:.3f} with memory, {lost:.3f} without")
    assert kept < lost
