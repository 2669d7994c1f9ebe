"""The table of the Zeroth-01 project: its numbers, and what its observation holds."""

import math

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from torch.testing import assert_close

from zfall.training.learner import Learner

WALKING = {
    "forward_velocity": 5.0,
    "stay_alive": 1.0,
    "feet_airtime": 2.5,
    "arm_pose": -2.0,
    "lateral_velocity": -1.0,
    "joint_limits": -10.0,
    "action_rate": -0.1,
}
RECOVER = {
    "upright": 2.0,
    "stable_height": 1.0,
    "feet_contact": 0.5,
    "energy": -0.01,
    "action_smoothness": -0.1,
    "survival": 0.1,
}


def config(compose_config, *overrides: str):
    return compose_config("env=zeroth_fall", "num_envs=4", *overrides).env


@pytest.mark.parametrize(
    ("overrides", "weights"), [([], WALKING), (["+reward=zf_recover"], RECOVER)]
)
def test_weights_are_those_published(compose_config, overrides, weights):
    cfg = config(compose_config, *overrides)
    terms = cfg.transforms.reward.terms
    assert {k: v[0] for k, v in terms.items() if v[0] is not None} == weights
    assert set(instantiate(cfg).reset()["reward_terms"].keys()) == set(weights)


def test_pushes_and_physics_are_those_of_the_presets(compose_config):
    more = ["+push=zf_easy", "+curriculum=zf", "+randomization=zf"]
    plain, preset = (OmegaConf.to_container(config(compose_config, *m)) for m in ([], more))
    defaults = {"profile": "rectangular", "direction": "planar"}
    for cfg in (plain, preset):
        push = {k: v for k, v in cfg["transforms"]["push"].items() if v is not None}
        cfg["transforms"]["push"] = defaults | push
    assert plain == preset


def test_observation_is_joints_imu_and_command(compose_config):
    ranges = ["vx=[0.1,0.3]", "pitch=[0.0,0.1]"]
    more = [f"env.transforms.command.ranges.{value}" for value in ranges]
    env = instantiate(config(compose_config, *more), training=False)
    assert (env.base_env.control_dt, env.base_env.physics_dt) == (0.02, 0.004)
    td = env.reset()
    for _ in range(10):
        td["action"] = 0.3 * torch.randn(4, 20)
        td = env.step(td)["next"]
    parts = [td[key] for key in ("joint_position", "joint_velocity", "base_orientation", "command")]
    assert td["observation"].shape == (4, 50)
    assert_close(td["observation"], torch.cat(parts, -1))  # upright still: w > 0
    assert ((td["command"][:, 0] >= 0.1) & (td["command"][:, 0] <= 0.3)).all()


def test_noise_is_in_what_the_policy_sees_and_not_in_what_the_critic_sees(compose_config):
    env = instantiate(compose_config("env=zeroth_fall", "num_envs=300").env)
    td = env.reset()
    error = td["observation"][:, :20] - td["joint_position"]
    assert error.std().item() == pytest.approx(0.01, rel=0.05)
    assert_close(td["observation_critic"][:, :20], td["joint_position"])
    assert_close(td["observation"][:, 20:40], td["joint_velocity"])


def test_action_is_an_angle_from_the_reference_pose(compose_config):
    env = instantiate(config(compose_config))
    td = env.reset()
    td["action"] = torch.full((4, 20), 0.05)
    expected = env.base_env.stand_position + 0.05
    assert_close(env.step(td)["next", "target"], expected.expand(4, 20))


@pytest.mark.parametrize("half", [0, 1])
@pytest.mark.parametrize(("preset", "weights"), [([], WALKING), (["+reward=zf_recover"], RECOVER)])
def test_every_term_can_be_switched_off_from_the_shell(compose_config, preset, weights, half):
    gone = set(list(weights)[half::2])
    off = [f"env.transforms.reward.terms.{name}.0=null" for name in gone]
    left = instantiate(config(compose_config, *preset, *off)).reset()["reward_terms"]
    assert set(left.keys()) == set(weights) - gone


def test_touchdown_threshold_is_a_value_of_the_shell(compose_config):
    """A robot dropped from 5 cm is paid for its whole fall where the threshold is 0."""
    key = "env.transforms.reward.terms.feet_airtime.1.threshold=0"
    cfg = OmegaConf.to_container(compose_config("env=zeroth_fall", "num_envs=4", key), resolve=True)
    table = cfg["env"]
    position = torch.tensor([[0.0, 0.0, 0.381]]).expand(4, 3)
    start = {
        "_target_": "zfall.envs.transforms.starts.ScriptedStart",
        "states": {"base_position": position},
    }
    table["transforms"]["start"], table["training_only"]["start"] = start, False
    env = instantiate(table, training=False)
    td, paid = env.reset(), torch.zeros(4, 1)
    for _ in range(8):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
        paid += td["reward_terms", "feet_airtime"]
    fall = math.sqrt(2 * 0.05 / 9.81)  # 0.101 s, seen in whole control steps, twice: both feet
    assert ((paid > 2.5 * 2 * (fall - 0.04)) & (paid <= 2.5 * 2 * fall)).all()


def test_a_policy_learns_on_it(compose_config):
    sizes = ["num_envs=6", "rollout_steps=4", "minibatches=2"]
    learner = Learner(compose_config("env=zeroth_fall", *sizes))
    for _ in range(2):
        means = learner.learn(learner.collect())
    assert all(math.isfinite(value) for value in means.values())


def test_stages_of_the_push_curriculum_are_those_of_the_report(compose_config):
    """Forces along x, y, z [N] and seconds between pushes: easy, medium, hard, kneel."""
    stages = {
        "push.axes.x": [20, 40, 60, 100],
        "push.axes.y": [10, 30, 50, 80],
        "push.axes.z": [0, 0, 10, 20],
    }
    parts = config(compose_config).transforms
    fields = OmegaConf.to_container(parts.curriculum.fields)
    rests = fields.pop("push.timing.interval")
    assert fields == {name: [[-n, n] for n in forces] for name, forces in stages.items()}
    assert rests == [[2, 4], [1.5, 3], [1, 2.5], [1, 2]]
    assert (parts.push.duration, parts.curriculum.stepwise) == (0.1, True)


def test_speed_ends_and_physics_are_those_of_template_and_design_notes(compose_config):
    parts = config(compose_config).transforms
    assert parts.reward.terms.forward_velocity[1].limit == 0.2
    ends = parts.terminations.conditions
    assert (ends.height.lowest, ends.height.highest, ends.tilt.angle) == (0.05, 0.5, 1.0)
    drawn = {k: [v.uniform, v.get("shared")] for k, v in parts.randomization.params.items()}
    assert drawn == {
        "foot_friction": [[0.5, 1.5], None],
        "link_mass": [[0.9, 1.1], True],
        "servo_stiffness": [[0.8, 1.2], True],
        "joint_damping": [[0.8, 1.2], True],
    }
    assert parts.noise.std == {"joint_position": 0.01}


def test_learning_is_that_of_the_report(compose_config):
    """AdamW with a rate of 3e-4, gradients of a norm of 2 at most."""
    cfg = compose_config("experiment=zeroth_fall")
    found = cfg.optimizer._target_, cfg.optimizer.lr, cfg.scheduler, cfg.max_grad_norm
    assert found == ("torch.optim.AdamW", 3e-4, None, 2.0)
