"""Two policies and the mode that chooses."""

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict import TensorDict
from torchrl.envs import ExplorationType, set_exploration_type

from tests.recurrent import SHAPES, live_through
from zfall import checkpoint
from zfall.configs import compose_config
from zfall.falling.switched import (
    SwitchedActor,
    sensing_and_acting,
    switched_actor,
    switched_checkpoint,
)
from zfall.modules.actors import recurrent_keys
from zfall.policies import load_policy

MLP = {"_target_": "zfall.modules.actors.mlp_actor", "num_cells": [8]}
GRU = {"_target_": "zfall.modules.actors.gru_actor", "hidden_size": 8, "num_layers": 1}


def specs(env):
    spec = env.observation_spec.clone()
    return spec, env.full_action_spec["action"]


@pytest.fixture
def env(compose_config):
    return instantiate(compose_config("experiment=push_to_kneel", "num_envs=3").env)


def test_the_mode_chooses_world_by_world(env):
    torch.manual_seed(0)
    actor = switched_actor(*specs(env), recover=MLP, kneel=MLP)
    td = TensorDict({"observation": torch.randn(3, env.observation_spec["observation"].shape[-1]),
                     "mode": torch.eye(3)}, batch_size=[3])  # fmt: skip
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        out = actor(td.clone())["action"]
        one, two = (part(td.clone())["action"] for part in (actor.recover, actor.kneel))
    assert torch.equal(out, torch.stack([one[0], two[1], two[2]]))
    assert not torch.equal(one, two)


def test_one_may_have_a_memory_and_both_may_not(env):
    actor = switched_actor(*specs(env), recover=GRU, kneel=MLP)
    assert "recurrent_state_actor" in actor.in_keys
    assert ("next", "recurrent_state_actor") in actor.out_keys
    rule = "must not both have a memory under one name, got recurrent_state_actor in both"
    with pytest.raises(ValueError, match=rule):
        SwitchedActor(actor.recover, actor.recover)


def test_memories_of_other_names_go_on_next_to_each_other(env):
    """A GRU and an LSTM over three steps: the memories of each are those it has by itself.

    Worlds 1 and 2 do not recover: there the memory for it stays as it begins.
    """
    lstm = {"_target_": "tests.recurrent.lstm_actor"}
    actor = switched_actor(*specs(env), recover=GRU, kneel=lstm)
    size = env.observation_spec["observation"].shape[-1]
    shapes = {"recurrent_state_actor": (1, 8)} | SHAPES["lstm"]
    assert {*recurrent_keys(actor)} == {*shapes}
    td = TensorDict({"observation": torch.randn(3, 4, size), "mode": torch.eye(3)[:, None].expand(3, 4, 3),
                     "is_init": torch.zeros(3, 4, 1, dtype=torch.bool)}, batch_size=[3, 4])  # fmt: skip
    both = live_through(actor, td, shapes)
    for part in (actor.recover, actor.kneel):
        own = {key: shapes[key] for key in recurrent_keys(part)}
        alone = live_through(part, td, own)
        for key in own:
            assert alone[key][:, 1:].abs().max() > 1e-3
            rows = 1 if part is actor.recover else 3
            assert torch.equal(both[key][:rows], alone[key][:rows])
            assert not both[key][rows:].any()


@pytest.mark.parametrize("begins", [True, False])
def test_a_memory_for_kneeling_begins_with_it_or_before(env, begins):
    """World 0 recovers, then kneels; what it does then is what a new memory would, or is not."""
    torch.manual_seed(0)
    actor = switched_actor(*specs(env), recover=MLP, kneel=GRU, begins=begins)
    size = env.observation_spec["observation"].shape[-1]
    key = "recurrent_state_actor"
    td = TensorDict({"observation": torch.randn(3, size), "mode": torch.eye(3),
                     "is_init": torch.zeros(3, 1, dtype=torch.bool)}, batch_size=[3])  # fmt: skip
    new = torch.zeros(3, 1, 8)
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        after = actor(td.clone().set(key, new))["next", key]
        assert after[1:].abs().amax((1, 2)).min() > 0
        assert bool((after[0] == 0).all()) is begins
        td["observation"] = torch.randn(3, size)
        td["mode"] = torch.eye(3)[[1, 1, 1]]
        action = actor(td.clone().set(key, after))["action"]
        fresh = actor.kneel(td.clone().set(key, new))["action"]
    assert torch.equal(action[0], fresh[0]) is begins
    assert not torch.equal(action[1], fresh[1])


def test_a_robot_that_got_up_recovers_with_a_new_memory(env):
    """Worlds 1 and 2 kneel, then recover; what they do then is what a new memory does."""
    torch.manual_seed(0)
    actor = switched_actor(*specs(env), recover=GRU, kneel=MLP)
    size = env.observation_spec["observation"].shape[-1]
    key = "recurrent_state_actor"
    td = TensorDict({"observation": torch.randn(3, size), "mode": torch.eye(3),
                     "is_init": torch.zeros(3, 1, dtype=torch.bool)}, batch_size=[3])  # fmt: skip
    old, new = torch.full((3, 1, 8), 0.5), torch.zeros(3, 1, 8)
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        after = actor(td.clone().set(key, old))["next", key]
        td["observation"] = torch.randn(3, size)
        td["mode"] = torch.eye(3)[[0, 0, 0]]
        action = actor(td.clone().set(key, after))["action"]
        fresh = actor.recover(td.clone().set(key, new))["action"]
    assert torch.equal(action[1:], fresh[1:])
    assert not torch.equal(action[0], fresh[0])


def test_who_leaves_the_way_down_to_the_script_does_nothing(env):
    still = {"_target_": "zfall.falling.switched.still_actor"}
    actor = switched_actor(*specs(env), recover=MLP, kneel=still)
    assert "observation" in actor.in_keys
    td = TensorDict({"observation": torch.randn(3, env.observation_spec["observation"].shape[-1]),
                     "mode": torch.eye(3)}, batch_size=[3])  # fmt: skip
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        action = actor(td)["action"]
    assert action[0].abs().max() > 0
    assert torch.equal(action[1:], torch.zeros(2, action.shape[1]))


ESTIMATORS = {
    "speed": {"_target_": "zfall.envs.transforms.estimation.NumericalVelocity", "before": "observation"},
    "lag": {"_target_": "zfall.envs.transforms.actions.LowPass", "time_constant": 0.02},
    "near": {"_target_": "zfall.envs.transforms.observations.CAPSNeighbours", "sigma": 0.1},
    "drift": {"_target_": "zfall.envs.transforms.observations.ObservationNoise", "std": {"joint_velocity": 0.1}},
}  # fmt: skip


def test_what_stands_between_policy_and_physics_is_found_by_what_it_does(compose_config):
    """Neighbours for a loss are no part of it, nor is the noise of training."""
    known = compose_config("experiment=push_to_kneel", "num_envs=3").env
    given = known.copy()
    OmegaConf.set_struct(given, False)
    for name, transform in ESTIMATORS.items():
        given.transforms[name] = transform
    given.training_only.drift = True
    assert sensing_and_acting(given, known) == ["speed", "lag"]
    assert sensing_and_acting(known, known) == []
    given.transforms.air = {"_target_": "zfall.envs.transforms.windows.FeetAirTime"}
    assert sensing_and_acting(given, known) == ["speed", "lag"]
    given.transforms.observation["keys"] = ["feet_air_time", "joint_position"]
    assert sensing_and_acting(given, known) == ["speed", "lag", "air"]


def test_a_policy_and_the_script_make_a_checkpoint_that_acts(tmp_path):
    changes = ["transforms.mode.probability=0.9", "transforms.mode.hold=0.04"]
    content = switched_checkpoint("best", "script", changes=changes)
    (tmp_path / "checkpoints").mkdir()
    checkpoint.save(tmp_path / "checkpoints" / "last.pt", content)
    policy, best = load_policy(tmp_path), load_policy("best")
    mode = policy.config.env.transforms.mode
    assert (mode.probability, mode.rest_speed, mode.initial) == (0.9, 0.1, "recover")
    env = policy.env(num_envs=2)
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        td = env.reset()
        assert torch.equal(policy.actor(td.clone())["action"], best.actor(td.clone())["action"])
        td["mode"] = torch.eye(3)[[1, 2]]
        assert not policy.actor(td.clone())["action"].any()


@pytest.mark.parametrize(
    ("recover", "kneel", "message"),
    [("nobody", "script", "recover .*nobody"), ("best", "best", "kneel .* best is not")],
)
def test_what_cannot_be_switched_is_refused(recover, kneel, message):
    with pytest.raises(ValueError, match=message):
        switched_checkpoint(recover, kneel)


def test_where_the_robot_rises_the_table_says_when_it_rests_and_how_its_tilt_is_known():
    """Not 0.1 m/s, as where a kneel is the end, and not the filter for small angles."""
    content = switched_checkpoint("twin_25hz", "script", env="push_to_stand")
    transforms = OmegaConf.create(content["config"]).env.transforms
    table = compose_config(["env=push_to_stand"]).env.transforms
    assert transforms.mode.rest_speed == table.mode.rest_speed > 0.1
    assert transforms.tilt["_target_"].endswith("MahonyFilter")
