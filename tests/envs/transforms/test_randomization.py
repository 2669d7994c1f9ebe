"""Draws of physical parameters, and sensors mounted askew."""

import math

import pytest
import torch
from scipy.stats import kstest, loguniform, norm, uniform
from torch.testing import assert_close

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.randomization import (
    DomainRandomization,
    ImuMisalignment,
    JointZeroOffset,
)
from zfall.robots import ZEROTH01
from zfall.robots.servos import STS3250
from zfall.rotations import rotate

ACTION = {"action": (JointPositionTarget, {"scale": 1.0})}


def randomized(make_task, params: dict, more: dict | None = None, interval=None, **kwargs):
    values = {"params": params, "interval": interval}
    return make_task({**ACTION, "random": (DomainRandomization, values), **(more or {})}, **kwargs)


@pytest.mark.parametrize(("distribution", "law"), [
    ({"uniform": [0.5, 1.5]}, uniform(0.5, 1.0)),
    ({"log_uniform": [0.5, 2.0]}, loguniform(0.5, 2.0)),
    ({"normal": [1.0, 0.2]}, norm(1.0, 0.2)),
])  # fmt: skip
def test_values_follow_their_law_and_reach_the_model(make_task, distribution, law):
    env = randomized(make_task, {"foot_friction": distribution}, num_envs=300)
    drawn = env.reset()["params", "foot_friction"]
    assert kstest(drawn[:, 0].numpy(), law.cdf).pvalue > 1e-3
    models = [env.base_env.simulation.model_of(world) for world in range(300)]
    foot = models[0].geom("left_foot").id
    assert_close(drawn[:, 0], torch.tensor([m.geom_friction[foot, 0] for m in models]).float())


def test_entries_are_drawn_one_by_one_or_shared_and_cut(make_task):
    own = {"normal": [1.0, 1.0], "clip": [0.5, 1.5]}
    params = {"joint_damping": own, "servo_stiffness": {"uniform": [0.8, 1.2], "shared": True}}
    drawn = randomized(make_task, params).reset()["params"]
    assert drawn["joint_damping"].amin() == 0.5
    assert drawn["joint_damping"].amax() == 1.5
    assert drawn["joint_damping"].std(1).min() > 0.1
    assert drawn["servo_stiffness"].std(1).max() == 0


def test_partial_reset_draws_for_its_rows_alone(make_task):
    env = randomized(make_task, {"link_mass": {"uniform": [0.9, 1.1]}}, num_envs=6)
    td = env.reset()
    before = td["params", "link_mass"].clone()
    rows = torch.tensor([[True], [False]] * 3)
    td["_reset"] = rows
    after = env.reset(td)["params", "link_mass"]
    assert (after != before).any(-1, keepdim=True).tolist() == rows.tolist()


def test_a_parameter_is_the_same_whatever_else_is_drawn(make_task):
    mass, friction = (
        {"link_mass": {"uniform": [0.9, 1.1]}},
        {"foot_friction": {"uniform": [0.5, 1.5]}},
    )
    both = randomized(make_task, mass | friction).reset()["params"]
    alone = randomized(make_task, friction).reset()["params"]
    assert torch.equal(both["foot_friction"], alone["foot_friction"])
    shares = (both["link_mass"][:, 0] - 0.9) / 0.2, both["foot_friction"][:, 0] - 0.5
    assert not torch.isclose(*shares, atol=1e-3).any()  # not one number used twice


def test_values_change_within_an_episode_at_the_interval(make_task):
    params = {"battery_voltage": {"uniform": [0.8, 1.0]}}
    env = randomized(make_task, params, interval=0.2)
    td, seen = env.reset(), []
    for _ in range(16):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
        seen.append(td["params", "battery_voltage"][:, 0])
    changes = (torch.stack(seen).diff(dim=0) != 0).all(1).nonzero()[:, 0] + 1
    assert changes.tolist() == [5, 10, 15]  # every five steps of 0.04 s


def test_the_encoder_and_the_servo_share_the_offset(make_task):
    """Held in the air, the joint reads its target although it stands elsewhere."""
    params = {"joint_zero_offset": {"uniform": [-0.1, 0.1]}}
    env = randomized(make_task, params, {"zero": (lambda env: JointZeroOffset(), {})})
    env.base_env.simulation.model.opt.gravity[:] = 0
    td = env.reset()
    env.base_env.simulation.qpos[:, 2] = 2.0
    for _ in range(60):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
    offset = td["params", "joint_zero_offset"]
    assert_close(td["measured", "joint_position"], td["joint_position"] + offset)
    reference = env.base_env.stand_position.expand(4, 20)
    read = (td["measured", "joint_position"] - reference).abs().mean()
    stands = (td["joint_position"] - reference).abs().mean()
    assert read < 0.01 < 0.03 < stands  # 0.2 N m of dry friction hold 0.006 rad


def test_zero_offset_without_a_draw_is_refused(make_task):
    with pytest.raises(ValueError, match="must come after a DomainRandomization"):
        make_task({**ACTION, "zero": (lambda env: JointZeroOffset(), {})})


def test_misalignment_turns_all_that_the_imu_measures_by_one_small_rotation(make_task):
    env = make_task({**ACTION, "imu": (ImuMisalignment, {"angle": 0.05})}, num_envs=64)
    td = env.reset()
    for _ in range(3):
        td["action"] = torch.randn(64, 20)
        td = env.step(td)["next"]
    turn = td["params", "imu_misalignment"]
    assert turn.abs().max() <= 0.05
    for key in ("projected_gravity", "base_angular_velocity"):
        true, measured = td[key], td["measured", key]
        # To first order a vector v reads v - r x v in axes turned by r.
        expected = true - torch.linalg.cross(turn, true)
        assert_close(measured, expected, atol=0.005 * true.norm(dim=-1).max().item(), rtol=0)
        assert_close(measured.norm(dim=-1), true.norm(dim=-1))
    half = torch.cat([torch.ones(64, 1), 0.5 * turn], -1)
    back = rotate(torch.nn.functional.normalize(half, dim=-1), td["measured", "projected_gravity"])
    assert_close(back, td["projected_gravity"], atol=1e-4, rtol=0)


@pytest.mark.parametrize(("params", "message"), [
    ({"mass": {"uniform": [0, 1]}}, "params must be of link_mass, .*got 'mass'"),
    ({"link_mass": {"uniform": [2, 1]}}, r"params.link_mass.uniform must be \[low, high\], got \[2, 1\]"),
    ({"link_mass": {"log_uniform": [0, 1]}}, "log_uniform must be of positive values"),
    ({"link_mass": {"normal": [1, -1]}}, "deviation >= 0"),
    ({"link_mass": {"normal": [1, 0.2], "clip": [1.7, 0.3]}}, r"link_mass.clip must be \[low, high\]"),
    ({"link_mass": {"normal": [1, 0.2], "clip": 0.5}}, "link_mass.clip must be two finite numbers, got 0.5"),
    ({"link_mass": {"normal": [1, math.nan]}}, "link_mass.normal must be two finite numbers"),
    ({"link_mass": {"uniform": [-1.0, -0.5]}}, r"link_mass.uniform must be within \[0.01, inf\]"),
    ({"foot_friction": {"uniform": [-1.0, 0.5]}}, r"foot_friction.uniform must be within \[0, inf\]"),
    ({"foot_friction": {"normal": [1, 1], "clip": [-1, 2]}}, r"foot_friction.clip must be within \[0, inf\]"),
    ({"foot_friction": {"uniform": ["a", "b"]}}, "foot_friction.uniform must be two finite numbers"),
    ({"foot_friction": {"uniform": [0.5]}}, r"foot_friction.uniform must be two finite numbers, got \[0.5\]"),
    ({"slope": {"uniform": [0, 2]}}, r"slope.uniform must be within \[-0.785, 0.785\]"),
    ({"link_mass": {"gamma": [1, 1]}}, "must hold just one of uniform, log_uniform, normal.*got gamma"),
])  # fmt: skip
def test_bad_values_are_refused(make_base, params, message):
    with pytest.raises(ValueError, match=message):
        DomainRandomization(make_base(), params=params)


def test_a_normal_distribution_is_cut_where_the_physics_ends(make_base):
    env = make_base(num_envs=64)
    wide = DomainRandomization(env, params={"foot_friction": {"normal": [0.5, 1.0]}})
    wide._reset_env_preprocess(None)
    friction = env.parameters.values["foot_friction"]
    # P(N(0.5, 1) < 0) = 0.31: of 64 some 20; the others are as they were drawn.
    assert 8 < (friction == 0).sum() < 34
    assert friction.min() == 0
    assert friction.max() > 1.5


def test_a_voltage_that_the_servos_do_not_bear_is_refused_before_anything_is_drawn(make_task):
    servos = dict.fromkeys(ZEROTH01.joints, STS3250)
    params = {"battery_voltage": {"uniform": [0.9, 1.1]}}
    with pytest.raises(ValueError, match=r"params.battery_voltage.*1.05"):
        randomized(make_task, params, servos=servos)
    drawn = randomized(make_task, {"battery_voltage": {"normal": [1.0, 1.0]}}, servos=servos)
    values = drawn.reset()["params", "battery_voltage"]
    assert values.min() >= 0.5
    assert values.max() <= 1.05 + 1e-6
