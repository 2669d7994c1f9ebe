"""The Zeroth-01 project's task with commands that are not zero."""

import pytest
import torch
from hydra.utils import instantiate
from torch.testing import assert_close

from zfall.envs.transforms.observations.derived import to_heading


@pytest.fixture(scope="module")
def cfg(compose_config):
    return compose_config("env=zeroth_walk", "num_envs=6").env


def test_the_observation_is_the_reports_50_numbers_seen_from_the_commanded_heading(cfg):
    env = instantiate(cfg, training=False)
    td = env.reset()
    for _ in range(25):
        td["action"] = torch.zeros(6, 20)
        td = env.step(td)["next"]
    assert_close(td["commanded_heading"][:, 0], 0.5 * td["command"][:, 2], atol=1e-5, rtol=0)
    seen = to_heading(td["base_orientation"], td["commanded_heading"])
    parts = [td["joint_position"], td["joint_velocity"], seen, td["command"]]
    assert_close(td["observation"], torch.cat(parts, -1))
    assert td["observation"].shape == (6, 50)


def test_the_reports_rewards_stay_but_for_those_that_do_not_say_where_to(cfg, compose_config):
    report = compose_config("env=zeroth_fall").env.transforms.reward.terms
    here = {name: term for name, term in cfg.transforms.reward.terms.items() if term is not None}
    kept = {"stay_alive", "arm_pose", "joint_limits"}
    assert {name for name in here if here[name] == report.get(name)} == kept
    assert set(here) - kept == {"velocity", "heading", "heading_far", "feet_airtime", "action_rate"}
    assert cfg.transforms.curriculum == compose_config("env=zeroth_fall").env.transforms.curriculum


def test_who_stands_is_paid_for_a_command_of_zero_alone(cfg):
    """At rest all of velocity's 5; told 0.25 m/s with a cutoff of 0.32: 5 x 0.01^0.6104 = 0.301."""
    told = cfg.copy()
    told.transforms.command.ranges = {"vx": [0.25, 0.25]}
    rest = cfg.copy()
    rest.transforms.command.ranges = {"vx": [0.0, 0.0]}
    paid = []
    for each in (told, rest):
        env = instantiate(each, training=False)
        td = env.reset()
        for _ in range(50):
            td["action"] = torch.zeros(6, 20)
            td = env.step(td)["next"]
        paid.append(td["reward_terms", "velocity"].mean().item())
        assert td["reward_terms", "heading"].mean().item() == pytest.approx(3.0, abs=0.05)
    assert paid == pytest.approx([0.301, 5.0], abs=0.1)
