"""The iCub table against the numbers of the paper, scaled, and against MuJoCo's own quantities."""

import math

import mujoco
import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from scipy.spatial.transform import Rotation
from torch.testing import assert_close

from zfall.robots import ZEROTH01
from zfall.training.learner import Learner

FAST = ["env=icub_balance", "env.base_env.physics_dt=0.005"]
# Table II of the paper: weight and cutoff, for a robot of 33 kg with its center of mass at 0.53 m.
MASS, LENGTH = ZEROTH01.mass / 33.0, ZEROTH01.com_height / 0.53
SPEED, TORQUE = math.sqrt(LENGTH), MASS * LENGTH
TABLE = {
    "joint_torques": (5, {"cutoff": 10.0 * TORQUE}),
    "joint_velocities": (2, {"cutoff": 1.0 / math.sqrt(LENGTH), "limit": math.pi}),
    "postural": (10, {"cutoff": math.radians(7.5)}),
    "com_z_velocity": (2, {"cutoff": 1.0 * SPEED}),
    "com_xy_velocity": (2, {"cutoff": 0.5 * SPEED}),
    "feet_contact_forces": (4, {"cutoff": 0.5 * ZEROTH01.mass * 9.81, "per_foot": True}),
    "centroidal_momentum": (1, {"linear": 50 * MASS * SPEED, "angular": 50 * TORQUE * SPEED}),
    "feet_cops": (20, {"cutoff": 0.3 * LENGTH, "per_foot": True}),
    "feet_orientation": (3, {"cutoff": 0.01, "per_foot": True}),
    "com_projection": (10, {"margin": 0.025 * LENGTH}),
    "feet_in_contact": (2, {"both": False}),
    "links_in_contact": (-10, {}),
}


@pytest.fixture
def table(compose_config):
    return compose_config(*FAST, "num_envs=4").env


def test_rates_are_those_of_the_paper(compose_config):
    base = compose_config("env=icub_balance").env.base_env
    assert (base.control_dt, base.physics_dt) == (1 / 25, 1 / 1000)


def test_weights_and_cutoffs_are_those_of_table_2_scaled(table):
    terms = table.transforms.reward.terms
    assert set(terms) == set(TABLE)
    for name, (weight, values) in TABLE.items():
        found = {k: v for k, v in terms[name][1].items() if not k.startswith("_")}
        assert terms[name][0] == weight, name
        assert found.pop("epsilon", 0.01) == 0.01, name
        assert found == pytest.approx(values, rel=0.04), name


def test_ranges_are_those_of_table_1_scaled(table):
    ranges = table.transforms.observation.ranges
    assert ranges.joint_velocity == pytest.approx([-math.pi, math.pi], rel=1e-5)
    assert ranges.roll_pitch == pytest.approx([-2 * math.pi, 2 * math.pi], rel=1e-5)
    assert ranges.feet_load == pytest.approx([0, ZEROTH01.mass * 9.81], rel=2e-3)
    assert ranges.com_velocity == pytest.approx([0, 3 * SPEED], rel=2e-3)


def test_push_and_randomisation_are_those_of_the_presets(compose_config):
    plain, preset = (
        OmegaConf.to_container(compose_config("env=icub_balance", *more).env.transforms)
        for more in ([], ["+push=icub", "+randomization=icub"])
    )
    for transforms in (plain, preset):
        push = {k: v for k, v in transforms["push"].items() if v is not None}
        transforms["push"] = {"profile": "rectangular"} | push
    assert plain == preset


def test_observation_is_that_of_table_1_from_mujocos_own_quantities(compose_config):
    nominal = ["~env.transforms.randomization", "~env.training_only.randomization"]
    env = instantiate(compose_config(*FAST, "num_envs=4", *nominal).env)
    td, base = env.reset(), env.base_env
    model, data = base.simulation.model, mujoco.MjData(base.simulation.model)
    for world in range(4):
        data.qpos[:], data.qvel[:] = base.simulation.qpos[world], base.simulation.qvel[world]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        robot = [data.joint(name) for name in ZEROTH01.joints]
        bounds = np.array([model.joint(name).range for name in ZEROTH01.joints])
        angles = np.array([joint.qpos[0] for joint in robot])
        expected = [
            (angles - bounds[:, 0]) / (bounds[:, 1] - bounds[:, 0]),
            np.array([joint.qvel[0] for joint in robot]) / (2 * math.pi) + 0.5,
            [data.qpos[2] / 0.4],
        ]
        turn = Rotation.from_quat(data.qpos[[4, 5, 6, 3]])
        expected.append(turn.as_euler("ZXY")[1:] / (4 * math.pi) + 0.5)
        expected += [td["feet_contact"][world].numpy(), td["feet_force"][world, :, 2] / 32.9]
        for foot in ("left", "right"):
            away = data.site(f"{foot}_sole").xpos - data.qpos[:3]
            expected.append(turn.inv().apply(away) / 0.4)
        expected.append(data.body("floating_base_link").subtree_linvel / 1.93)
        found = td["observation"][world].numpy()
        assert found.shape == (56,)
        np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-5)
    assert torch.equal(td["observation_critic"], td["observation"])


def test_a_standing_robot_earns_nearly_all_there_is(table):
    env = instantiate(table, training=False)
    td = env.reset()
    for _ in range(50):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
    most = {name: weight for name, (weight, _) in TABLE.items() if weight > 0}
    for name, (_, values) in TABLE.items():
        if "per_foot" in values:
            most[name] *= 2
    for name, weight in most.items():
        share = td["reward_terms", name] / weight
        assert ((share > 0.75) & (share <= 1.0)).all(), name
    assert (td["reward"] > 0.9 * sum(most.values())).all()


def test_a_link_on_the_floor_costs_ten_and_ends_the_episode(compose_config):
    table = OmegaConf.to_container(compose_config(*FAST, "num_envs=4"), resolve=True)["env"]
    lying = torch.tensor([[math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0]]).expand(4, 4)
    start = {
        "_target_": "zfall.envs.transforms.starts.ScriptedStart",
        "states": {
            "base_orientation": lying,
            "base_position": torch.tensor([[0.0, 0.0, 0.05]]).expand(4, 3),
        },
    }
    table["transforms"]["start"], table["training_only"]["start"] = start, False
    env = instantiate(table, training=False)
    td = env.reset()
    td["action"] = torch.zeros(4, 20)
    after = env.step(td)["next"]
    assert_close(after["reward_terms", "links_in_contact"], torch.full((4, 1), -10.0))
    assert after["terminated"].all()


@pytest.mark.parametrize("half", [0, 1])
def test_every_term_can_be_switched_off_from_the_shell(compose_config, half):
    gone = set(list(TABLE)[half::2])
    off = [f"env.transforms.reward.terms.{name}.0=null" for name in gone]
    env = instantiate(compose_config(*FAST, "num_envs=2", *off).env)
    assert set(env.reset()["reward_terms"].keys()) == set(TABLE) - gone


def test_a_policy_learns_on_it(compose_config):
    learner = Learner(compose_config(*FAST, "num_envs=6", "rollout_steps=4", "minibatches=2"))
    for _ in range(2):
        means = learner.learn(learner.collect())
    assert all(math.isfinite(value) for value in means.values())


def test_starts_pushes_and_physics_are_those_of_the_paper(compose_config):
    """10 degrees, 90 degrees/s; 200 N for 0.2 s on 33 kg, every 5 s; 20 ms; a fifth of the mass."""
    parts = compose_config("env=icub_balance").env.transforms
    noise = parts.start.joint_position, parts.start.joint_velocity
    assert noise == pytest.approx((math.radians(10), math.radians(90)), rel=1e-4)
    size = 200 * 0.2 / (33 * math.sqrt(9.81 * 0.53))
    assert parts.push["size"] == pytest.approx([size, size], rel=0.01)
    assert parts.push.duration == pytest.approx(0.2 * SPEED, rel=0.02)
    pushed = parts.push.mean_interval, parts.push.direction, parts.push.point
    assert pushed == (5.0, "spherical", "pelvis")
    assert parts.delay.delay == [0.0, 0.02]
    params = parts.randomization.params
    assert (params.link_mass.normal, params.foot_friction.uniform) == ([1.0, 0.2], [0.5, 3.0])


def test_learning_is_that_of_table_3(compose_config):
    cfg = compose_config("experiment=icub_balance")
    loss = cfg.loss
    assert (loss.gamma, loss.lmbda, loss.clip_epsilon, loss.value_clip) == (0.95, 1.0, 0.3, 1000.0)
    assert loss.kl_coeff > 0
    found = cfg.optimizer.lr, cfg.scheduler, cfg.epochs, cfg.num_envs, cfg.total_frames
    assert found == (1e-4, None, 32, 32, 20_000_000)
