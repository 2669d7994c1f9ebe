"""The table of Atalante's task as a whole."""

import math

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import JointVelocityTarget
from zfall.envs.transforms.rewards import WeightedReward
from zfall.evaluation.pendulum import no_step_bound
from zfall.robots import ZEROTH01

TERMS = {"odometry", "configuration", "feet_position", "feet_orientation", "capture_point",
         "zero_moment_point", "weight", "tangential", "turning"}  # fmt: skip
# From Atalante, 135 kg with its center of mass at 0.95 m, to Zeroth-01.
LENGTH, FORCE = ZEROTH01.com_height / 0.95, ZEROTH01.mass / 135
TIME = math.sqrt(LENGTH)
LIMITS = {"height", "tilt", "feet", "stops", "drift", "transient", "power"}
QUIET = ["env.transforms.push.force=[0,0]"]
_START = "env.transforms.start"
AT_REST = [
    *QUIET,
    f"+{_START}.motions=[standing]",
    f"{_START}.joint_position=0",
    f"{_START}.joint_velocity=0",
]


@pytest.fixture
def build(compose_config):
    def make(*overrides: str, num_envs: int = 3):
        cfg = compose_config("env=atalante_standing", f"num_envs={num_envs}", *overrides)
        env = instantiate(cfg.env)
        env.set_seed(0)
        return env

    return make


def hold(env, seconds: float):
    """Servos that hold the standing pose; what follows each step."""
    td = env.reset()
    for _ in range(round(seconds / env.base_env.control_dt)):
        td["action"] = torch.zeros(env.num_envs, 20)
        td = env.step(td)["next"]
        yield td


def test_observation_is_that_of_the_paper_and_the_critic_sees_the_same(build):
    """Roll, pitch, 3 rates, 8 forces, and 20 angles, velocities and targets each: 73."""
    env = build()
    for td in hold(env, 0.2):
        seen = td["observation"]
        assert seen.shape == (3, 73)
        assert torch.equal(seen, td["observation_critic"])
        assert_close(seen[:, :2], td["tilt"], atol=0.06, rtol=0)
        assert_close(seen[:, 2:5], td["base_angular_velocity"], atol=0.3, rtol=0)
        assert_close(seen[:, 5:13], td["feet_corner_force"].flatten(1), atol=2.5, rtol=0)
        assert_close(seen[:, 13:33], td["joint_position"], atol=0.03, rtol=0)
        assert_close(seen[:, 53:], td["target"])
    assert_close(seen[:, 33:53], td["joint_velocity"], atol=0.4, rtol=0)


def test_rates_are_25_and_100_hz_over_a_physics_of_5_ms(build):
    env = build()
    base = env.base_env
    assert (base.control_dt, base.physics_dt) == (0.04, 0.005)
    target = next(t for t in env.transform if isinstance(t, JointVelocityTarget))
    assert target.tick == pytest.approx(0.01)


def test_limits_are_those_of_section_iv_c_scaled(compose_config):
    """0.3 m of 0.95, 2 cm, 0.6 rad/s, 2 and 3 m, 3 kW; angles and times as they are."""
    transforms = compose_config("env=atalante_standing").env.transforms
    conditions = OmegaConf.to_container(transforms.terminations.conditions)
    found = {k: {n: x for n, x in v.items() if n[0] != "_"} for k, v in conditions.items()}
    trunk = 0.332017  # height of the base above the floor where it stands
    expected = {
        "height": {"height": 0.3 / 0.95 * trunk},
        "tilt": {"roll": [-0.4, 0.4], "pitch": [-0.25, 0.7]},
        "feet": {"distance": 0.02 * LENGTH},
        "stops": {"speed": 0.6 / TIME},
        "drift": {"x": 2.0 * LENGTH, "y": 3.0 * LENGTH, "heading": math.pi / 2},
        "transient": {"error": 0.3},
        "power": {"power": 3000 * FORCE * LENGTH / TIME},
    }
    assert set(found) == set(expected)
    for name, values in expected.items():
        assert set(found[name]) == set(values), name
        for key, value in values.items():
            assert found[name][key] == pytest.approx(value, rel=0.08), (name, key)
    assert transforms.displacement.seconds == 20.0
    assert transforms.joint_error.seconds == 4.0
    assert transforms.joint_error.joints == "legs"


def test_pushes_are_those_of_section_iv_a_scaled(compose_config):
    """Bells of 800 N for 0.4 s at the pelvis, every 3 s with 2 s of jitter; also the preset's."""
    for overrides in ([], ["+push=atalante"]):
        push = compose_config("env=atalante_standing", *overrides).env.transforms.push
        assert push.force == pytest.approx([800 * FORCE] * 2, rel=0.02)
        assert push.duration == pytest.approx(0.4 * TIME, rel=0.02)
        assert [x + push.duration for x in push.interval] == pytest.approx([1.0, 5.0])
        assert (push.point, push.profile, push.direction) == ("pelvis", "gaussian", "spherical")


def test_pushes_that_ask_for_steps_are_larger_than_feet_withstand_forward_alone(compose_config):
    """A bell's mean is 0.417 of its peak; sideways the ankles of a pendulum still suffice."""
    cfg = compose_config("env=atalante_standing", "+push=atalante_stepping", "num_envs=2")
    push = cfg.env.transforms.push
    published = compose_config("env=atalante_standing", "num_envs=2").env.transforms.push
    for key in ("point", "direction", "profile", "duration", "interval"):
        assert push[key] == published[key]
    bound = no_step_bound(ZEROTH01, [0.0, math.pi / 2], push.duration)
    unit = 0.4167 * push.duration / ZEROTH01.impulse_unit
    assert published.force[1] * unit < bound[0] < push.force[0] * unit < bound[1]


def test_reward_is_a_normalised_sum_of_nine_and_next_to_1_at_rest(build):
    env = build(*AT_REST)
    reward = next(t for t in env.transform if isinstance(t, WeightedReward))
    weights = {name: weight for name, (weight, _) in reward.terms.items()}
    assert set(weights) == TERMS
    assert sum(weights.values()) == pytest.approx(1.0)
    assert min(weights.values()) > 0
    *_, td = hold(env, 2.0)
    assert (td["reward"] > 0.98).all()
    for name, weight in weights.items():
        assert (td["reward_terms", name] > 0.95 * weight).all(), name


def test_every_term_tells_rest_from_random_motion_and_none_goes_to_nothing(build):
    """Actions of a standard deviation of 0.3, in the 0.4 s before most of it falls."""
    env = build(*QUIET, num_envs=64)
    reward = next(t for t in env.transform if isinstance(t, WeightedReward))
    td, seen = env.reset(), []
    for _ in range(10):
        td["action"] = 0.3 * torch.randn(64, 20)
        data, td = env.step_and_maybe_reset(td)
        seen.append(data["next", "reward_terms"])
    for name, (weight, _) in reward.terms.items():
        mean = torch.stack([terms[name] for terms in seen]).mean().item() / weight
        assert 0.2 < mean < 0.9, name


def test_standing_breaks_no_limit_for_ten_seconds(build):
    env = build(*AT_REST)
    for td in hold(env, 10.0):
        assert set(td["terminations"].keys()) == LIMITS
        assert not td["done"].any()


def test_episodes_last_60_s_at_most(build):
    limit = next(t for t in build().transform if hasattr(t, "max_steps"))
    assert limit.max_steps * 0.04 == pytest.approx(60.0)


def test_plain_reward_is_1_for_every_step_but_the_last(build):
    env = build("+ablation=plain_reward", num_envs=16)
    check_env_specs(env)
    td = env.reset()
    for _ in range(40):
        td["action"] = 0.5 * torch.randn(16, 20)
        data, td = env.step_and_maybe_reset(td)
        after = data["next"]
        assert torch.equal(after["reward"], 1.0 - after["terminated"].float())
    assert set(after["reward_terms"].keys()) == {"survival"}


def test_without_limits_only_a_fall_ends_an_episode(build):
    env = build("+ablation=no_limits", num_envs=16)
    check_env_specs(env)
    td, ends = env.reset(), 0
    for _ in range(60):
        td["action"] = 0.5 * torch.randn(16, 20)
        data, td = env.step_and_maybe_reset(td)
        after = data["next"]
        assert set(after["terminations"].keys()) == {"fall"}
        touched = (after["contact_force_peak"][:, :-2] > 0).any(-1, keepdim=True)
        assert torch.equal(after["done"], touched)
        ends += int(touched.sum())
    assert ends > 5
    assert set(after["reward_terms"].keys()) == TERMS


def test_both_ablations_go_together(build):
    env = build("+ablation=[plain_reward,no_limits]")
    check_env_specs(env)
    *_, td = hold(env, 0.2)
    assert set(td["terminations"].keys()) == {"fall"}
    assert set(td["reward_terms"].keys()) == {"survival"}
