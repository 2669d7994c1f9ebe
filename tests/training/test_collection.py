"""Worlds in groups that take turns."""

import random
import time
from contextlib import contextmanager

import pytest
import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict import TensorDictBase

from zfall.simulation import cpu as simulation
from zfall.simulation.turns import others_turn
from zfall.studies.store import training_digest
from zfall.training.collection import Worlds, group_sizes
from zfall.training.metrics import batch_metrics

HARD = ("env=push_recovery_realistic", "env.transforms.limit.seconds=0.3",
        "env.transforms.push.interval=[0.0,0.1]")  # fmt: skip
KEYS = ["observation", "observation_critic", "action", ("next", "reward"), ("next", "done"),
        ("next", "observation")]  # fmt: skip


def steady(td: TensorDictBase) -> TensorDictBase:
    """An action that depends on what is observed alone."""
    return td.set("action", torch.sin(3.0 * td["observation"][:, : td["joint_position"].shape[1]]))


def exploring(td: TensorDictBase) -> TensorDictBase:
    """An action from the random numbers that all share."""
    return td.set("action", torch.randn(td["joint_position"].shape))


@pytest.mark.parametrize(
    ("num_envs", "groups", "sizes"),
    [(512, None, [256, 256]), (255, None, [255]), (256, 1, [256]), (7, 3, [3, 2, 2]), (1, 1, [1])],
)
def test_groups_are_as_equal_as_can_be(num_envs, groups, sizes):
    assert group_sizes(num_envs, groups) == sizes


def test_too_many_worlds_are_refused_by_the_number_that_was_given(compose_config):
    with pytest.raises(InstantiationException, match=r"num_envs must fit .* got 1000000001"):
        Worlds(compose_config().env, 1_000_000_001, 2)


def test_each_group_is_what_it_would_be_alone(compose_config):
    env_cfg = compose_config(*HARD).env
    worlds = Worlds(env_cfg, 7, groups=2)
    worlds.begin(seed=3)
    batch = worlds.run(steady, 24, KEYS)
    assert batch.shape == (7, 24)
    assert batch["next", "done"].any()
    seed, begin = 3, 0
    for size in (4, 3):
        env = instantiate(env_cfg, base_env={"num_envs": size})
        seed = env.set_seed(seed)
        td = env.reset()
        for step in range(24):
            data, td = env.step_and_maybe_reset(steady(td))
            for key in KEYS:
                assert torch.equal(batch[key][begin : begin + size, step], data[key]), (key, step)
        assert torch.equal(worlds.carrier["observation"][begin : begin + size], td["observation"])
        begin += size
    assert not torch.equal(batch["observation"][0], batch["observation"][4])


@pytest.mark.long
def test_shared_random_numbers_are_drawn_alike_however_long_the_physics_takes(
    compose_config, monkeypatch
):
    pauses = random.Random(0)

    @contextmanager
    def late():
        with others_turn():
            yield
            time.sleep(pauses.uniform(0.0, 0.01))

    batches = []
    for function in (others_turn, late, late):
        monkeypatch.setattr(simulation, "others_turn", function)
        torch.manual_seed(5)
        worlds = Worlds(compose_config(*HARD).env, 6, groups=3)
        worlds.begin(seed=1)
        batches.append(worlds.run(exploring, 12, KEYS))
    for key in KEYS:
        assert all(torch.equal(batches[0][key], other[key]) for other in batches[1:]), key


def test_state_in_the_middle_of_episodes_goes_on_bit_for_bit(compose_config):
    env_cfg = compose_config(*HARD).env
    worlds, others = (Worlds(env_cfg, 6, groups=2) for _ in range(2))
    worlds.begin(seed=1)
    others.begin(seed=2)
    worlds.run(steady, 10, KEYS)
    state = worlds.state_dict()
    expected = worlds.run(steady, 15, KEYS)
    others.load_state_dict(state)
    batch = others.run(steady, 15, KEYS)
    for key in KEYS:
        assert torch.equal(batch[key], expected[key]), key


def test_a_state_of_other_groups_and_a_run_before_it_began_are_refused(compose_config):
    env_cfg = compose_config().env
    worlds, others = Worlds(env_cfg, 5, groups=2), Worlds(env_cfg, 5, groups=1)
    with pytest.raises(RuntimeError, match=r"Worlds\.begin must come before Worlds\.run"):
        worlds.run(steady, 1, KEYS)
    for each in (worlds, others):
        each.begin(seed=0)
    with pytest.raises(ValueError, match=r"groups must be .* of \[3, 2\] worlds, got \[5\]"):
        others.load_state_dict(worlds.state_dict())


def test_an_env_that_cannot_be_spread_is_one_group():
    env_cfg = OmegaConf.create({"_target_": "tests.memory_task.make_env", "num_envs": 300})
    assert [len(env.reset()) for env in Worlds(env_cfg, 300).envs] == [300]
    with pytest.raises(ValueError, match=r"groups must be 1 or null without env\.base_env, got 2"):
        Worlds(env_cfg, 300, groups=2)


def test_a_training_is_the_same_in_any_number_of_groups(compose_config):
    """To a study: its results are kept by this digest."""
    digests = {training_digest(compose_config(f"groups={n}")) for n in ("null", 1, 2)}
    assert len(digests) == 1
    assert training_digest(compose_config("seed=1")) not in digests


def test_worlds_whose_action_is_not_finite_are_counted_and_nothing_else_of_them_is_seen(
    compose_config,
):
    """One of four worlds is given NaN in the second of six steps."""
    worlds, steps = Worlds(compose_config(*HARD).env, 4, groups=2), iter(range(100))

    def spoilt(td: TensorDictBase) -> TensorDictBase:
        td = steady(td)
        if next(steps) == 2:  # of the first group, as groups are stepped one after the other
            td["action"] = td["action"].index_fill(0, torch.tensor([1]), torch.nan)
        return td

    worlds.begin(seed=3)
    batch = worlds.run(spoilt, 6, [*KEYS, ("next", "terminated"), ("next", "diverged")])
    assert batch_metrics_of(batch, worlds)["diverged"] == 1
    for key in [*KEYS, ("next", "reward")]:
        assert batch[key].float().isfinite().all(), key


def batch_metrics_of(batch: TensorDictBase, worlds: Worlds) -> dict[str, float]:
    batch["next", "episode_reward"] = batch["next", "reward"]
    return batch_metrics(batch, worlds.carrier, 0.04)
