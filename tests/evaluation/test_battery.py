"""Planar battery: its plan, its seeds, and known truths."""

import numpy as np
import pandas as pd
import pytest
import torch
from tensordict import TensorDict

from tests.block import block_robot
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.tables import keep
from zfall.envs.transforms.pushes import ScriptedPush
from zfall.evaluation.battery import battery_env, play, run_battery, trial_parameters
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.plans import plan_trials
from zfall.training.learner import Learner

SMALL = {"impulses": [0.1, 0.9], "starts": 2, "directions": 4, "end_time": 5.0}
SOON = SMALL | {"push_time": 0.2, "end_time": 1.2}  # over once the first have fallen


def test_a_battery_runs_on_the_nominal_robot_with_its_own_pushes_alone(compose_config):
    cfg = compose_config("env=push_recovery_realistic").env
    env, _, _ = battery_env(load_battery("planar"), cfg, 2)
    base = env.base_env
    env.reset()
    models = [base.simulation.model_of(world) for world in range(2)]
    for field in ("body_mass", "geom_friction", "actuator_gainprm", "dof_damping"):
        assert all(
            (getattr(m, field) == getattr(base.simulation.model, field)).all() for m in models
        )
    made = {type(t).__name__ for t in env.transform}
    assert made.isdisjoint({"RandomPush", "VelocityKick", "ThrownBall", "ObservationNoise"})
    assert made.isdisjoint({"ActuatorDelay", "DomainRandomization", "Curriculum", "NoisyStart"})
    assert made >= {"ServoPlanner", "LowPass", "Deadband", "Backlash"}  # the robot's own
    assert sum(isinstance(t, ScriptedPush) for t in env.transform) == 1


@pytest.mark.parametrize(
    "only", [[], ["env.training_only.start=false", "env.training_only.push=false"]]
)
def test_nothing_starts_or_pushes_beside_a_battery(compose_config, only):
    """Named in ``training_only`` or not, as one added from the shell."""
    kick = "{_target_: zfall.envs.transforms.pushes.VelocityKick, velocity: [0.1, 0.5], interval: [2, 4], before: last_action}"
    env, start, push = battery_env(
        load_battery("planar"), compose_config(*only, f"+env.transforms.kick={kick}").env, 2
    )
    made = {type(t).__name__ for t in env.transform if t not in (start, push)}
    assert made.isdisjoint({"NoisyStart", "RandomPush", "VelocityKick"})


@pytest.mark.parametrize(
    ("battery", "message"),
    [
        ("planar_slippery", "planar_slippery must be the only one to set foot_friction"),
        ("planar_payload", "planar_payload must be the only one to set link_mass"),
    ],
)
def test_physics_that_a_battery_sets_is_not_drawn_anew(compose_config, battery, message):
    cfg = compose_config("+randomization=icub", "env.training_only.randomization=false").env
    with pytest.raises(ValueError, match=message):
        battery_env(load_battery(battery), cfg, 2)


def test_randomised_physics_may_stay_where_the_battery_sets_none(compose_config):
    cfg = compose_config("+randomization=icub", "env.training_only.randomization=false").env
    env, _, _ = battery_env(load_battery("planar"), cfg, 2)
    assert "DomainRandomization" in {type(t).__name__ for t in env.transform}


@pytest.fixture(scope="module")
def results(compose_config) -> dict[str, pd.DataFrame]:
    cfg = compose_config("num_envs=64")
    battery = load_battery("planar", **SMALL)
    held = run_battery(battery, cfg.env, None, num_envs=64)
    limp = run_battery(battery, cfg.env, None, num_envs=64, servos=False)
    return {"pose_hold": held, "limp": limp}


def test_held_pose_stands_without_a_push_and_limp_falls(results):
    held, limp = results["pose_hold"], results["limp"]
    assert held[held["impulse"] == 0]["recovered"].all()
    assert held[held["impulse"] == 0.1]["recovered"].all()
    assert not held[held["impulse"] == 0.9]["recovered"].any()
    assert limp["fell"].all()
    assert (limp["time_to_fall_s"] < 0).all()  # before the push


def test_outcomes_are_consistent(results):
    held = results["pose_hold"]
    assert not (held["recovered"] & held["fell"]).any()
    assert held["time_to_fall_s"].notna().equals(held["fell"])
    fallen = held[held["fell"]]
    assert (fallen["time_to_fall_s"] > 0.1).all()
    assert (fallen["peak_contact_force"] > 0).all()
    assert (held[~held["fell"]]["peak_contact_force"] == 0).all()
    assert (held["peak_base_acceleration"] > 9.7).all()


@pytest.mark.long
def test_trials_do_not_depend_on_the_number_of_worlds(compose_config):
    """More trials than fit into 64 worlds: two rounds of these, or one of 128."""
    cfg = compose_config("num_envs=64")
    policy = Learner(cfg).actor
    battery = load_battery("planar", **(SOON | {"starts": 10}))
    narrow, wide = (run_battery(battery, cfg.env, policy, num_envs=n) for n in (64, 128))
    assert len(wide) > 64
    assert 0 < wide["fell"].sum() < len(wide)
    pd.testing.assert_frame_equal(narrow, wide)


def test_trials_with_noise_and_delays_do_not_depend_on_their_company(compose_config):
    """All at once, in two chunks of 64, and one of the second chunk alone, with two threads."""
    plain = compose_config("num_envs=64", "env=push_recovery_realistic").env
    names = [
        "delay",
        "randomization",
        "late",
        "zero",
        "imu",
        "bias",
        "drift",
        "noise",
        "bits",
        "lost",
    ]
    cfg = keep(plain, names)
    battery = load_battery("planar", **(SMALL | {"starts": 6, "push_time": 0.2, "end_time": 0.6}))
    wide, narrow = (run_battery(battery, cfg, None, num_envs=n) for n in (128, 64))
    assert len(wide) > 64
    pd.testing.assert_frame_equal(narrow, wide)
    torch.set_num_threads(2)
    alone = run_battery(battery, cfg, None, only=[70])
    pd.testing.assert_frame_equal(alone, wide[70:71].reset_index(drop=True))
    quiet = run_battery(battery, plain, None, only=[70])
    assert (quiet["peak_tilt"] != alone["peak_tilt"]).all()


@pytest.mark.parametrize("actor", ["mlp_gaussian", "gru_mog"])
def test_same_seed_gives_the_same_table_and_another_seed_another(compose_config, actor):
    cfg = compose_config("num_envs=4", f"actor={actor}")
    policy = Learner(cfg).actor
    battery = load_battery("planar", **(SOON | {"directions": 2}))
    tables = [run_battery(battery, cfg.env, policy, seed=seed, num_envs=64) for seed in (0, 0, 1)]
    pd.testing.assert_frame_equal(tables[0], tables[1])
    assert not np.allclose(tables[0]["peak_tilt"], tables[2]["peak_tilt"])


def test_policy_runs_without_exploration(compose_config):
    """A policy that would act at random if explored, and holds the pose on average."""
    cfg = compose_config("num_envs=4", "actor.std=5.0")
    policy = Learner(cfg).actor
    with torch.no_grad():
        for parameter in policy.parameters():
            if parameter.ndim == 2:
                parameter.zero_()
    battery = load_battery("planar", **(SMALL | {"impulses": [0.1]}))
    assert run_battery(battery, cfg.env, policy, num_envs=64)["recovered"].all()


def test_pose_hold_goes_to_the_reference_under_velocity_targets(compose_config):
    """From 2 degrees beside it on all joints: the target is there in the first step, and stays."""
    cfg = compose_config("env=atalante_standing").env
    env, start, _ = battery_env(load_battery("planar"), cfg, 64)
    pose = env.base_env.stand_position
    start.states["joint_position"] = (pose + 0.035).repeat(64, 1)
    targets = [td["target"] for td in play(env, None, 5)]
    for target in targets:
        torch.testing.assert_close(target, pose.expand(64, -1), atol=1e-5, rtol=0)


def test_masses_and_loads_are_drawn_for_each_trial_from_its_own_seed(make_base):
    base = make_base(num_envs=4)
    trials = plan_trials(load_battery("planar"), 4.92, seed=3)
    params = trial_parameters(load_battery("planar_payload"), trials, base)
    mass, load = params["link_mass"], params["payload"]
    assert (mass == mass[:, :1]).all()
    assert 0.8 <= mass.min() < 0.81
    assert 1.19 < mass.max() <= 1.2
    column = list(base.parameters.push_points).index("chest")
    assert 0.29 < load[:, column].max() <= 0.3
    assert load.sum() == load[:, column].sum()
    alone = trial_parameters(load_battery("planar_payload"), trials.iloc[77:78], base)
    assert torch.equal(alone["link_mass"][0], mass[77])
    assert abs(np.corrcoef(mass[:, 0], load[:, column])[0, 1]) < 0.05
    slippery = trial_parameters(load_battery("planar_slippery"), trials, base)
    assert set(slippery) == {"foot_friction"}
    assert (slippery["foot_friction"] == 0.2).all()
    assert trial_parameters(load_battery("planar"), trials, base) == {}


def test_payload_battery_weighs_what_it_says(compose_config):
    """Force of the floor on standing feet: total mass of each trial times g."""
    cfg = compose_config("num_envs=64")
    battery = load_battery("planar_payload", **(SOON | {"end_time": 0.4}))
    table = run_battery(battery, cfg.env, None, num_envs=64)
    assert table["mass_factor"].between(0.8, 1.2).all()
    env, _, _ = battery_env(battery, cfg.env, 64)
    base, trials = env.base_env, plan_trials(battery, 1.0, 0)
    rows = trials.iloc[np.arange(64).clip(max=len(trials) - 1)]
    params = trial_parameters(battery, rows, base)
    base.set_physics_params(TensorDict(params, batch_size=[64]))
    last = list(play(env, None, 60))[-1]
    weight = last["feet_force"][..., 2].sum(1).numpy()[: len(trials)]
    expected = 9.81 * (3.3494 * table["mass_factor"] + table["load_kg"])
    np.testing.assert_allclose(weight, expected, rtol=0.01)


def test_a_load_needs_a_chest_to_lie_on(tmp_path):
    env = HumanoidEnv(num_envs=1, control_dt=0.04, robot=block_robot(tmp_path))
    trials = pd.DataFrame({"seed": [0], "trial": [0]})
    with pytest.raises(ValueError, match="battery.load must have a push point chest .* block has"):
        trial_parameters(load_battery("planar_payload"), trials, env)
