"""The papers' experiments: they learn, and a laptop gets the same task."""

import numpy as np
import pandas as pd
import pytest
from hydra.utils import instantiate

from tests.shell import TINY, run
from zfall.falling.files import own_file
from zfall.policies.load import load_policy
from zfall.robots import ZEROTH01
from zfall.training.stages import stages_of

FALLS = own_file(ZEROTH01, "falls.npz")
WALK = "experiment=zeroth_walk"
PAPERS = ["icub_balance", "atalante_standing", "zeroth_fall"]


@pytest.mark.parametrize(
    "name",
    [
        *(name + end for name in PAPERS for end in ("", "_laptop")),
        "best_gru",
        "icub_balance_tuned",
        "push_to_kneel_softly",
    ],
)
def test_every_experiment_learns(name, tmp_path):
    """Its networks, loss and optimizer, on a small batch."""
    own = []
    if name == "push_to_kneel_softly":  # a bank of what was seen, here made up
        with np.load(FALLS) as file:
            states = dict(file)
        count = len(states["push_left"])
        states |= {"target": states["joint_position"], "feet_force": np.zeros((count, 6), "f4")}
        states["com_velocity"] = states["base_linear_velocity"]
        np.savez(tmp_path / "falls.npz", **states)
        own = [f"env.transforms.falling.bank={tmp_path}/falls.npz"]
    done = run("train", f"experiment={name}", *own, *TINY, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr
    metrics = pd.read_csv(tmp_path / "run" / "metrics.csv")
    assert metrics["frames"].tolist() == [32, 64]
    assert metrics.filter(regex="^loss/").notna().all(axis=None)


def test_who_walks_is_pushed_hard_in_the_second_of_three_stages(tmp_path, compose_config):
    stages = [stage.config.env.transforms for stage in stages_of(compose_config(WALK))]
    assert [each.curriculum is not None for each in stages] == [False, True, False]
    assert [each.push.axes.x for each in stages] == [[-8, 8], [-20, 20], [-8, 8]]
    few = [f"stages.{name}.total_frames=32" for name in ("walk", "pushed", "settle")]
    tiny = [each for each in TINY if not each.startswith("total_frames")]
    done = run("train", WALK, *few, *tiny, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr
    metrics = pd.read_csv(tmp_path / "run" / "metrics.csv")
    assert metrics["stage"].tolist() == [1, 2, 3]
    assert metrics.filter(regex="^loss/").notna().all(axis=None)


def test_soft_landings_are_rewarded_outside_training_too(compose_config):
    """What evaluation leaves out, the rewards do not read."""
    bank = f"env.transforms.falling.bank={FALLS}"
    cfg = compose_config("experiment=push_to_kneel_softly", bank, "num_envs=2")
    env = instantiate(cfg.env, training=False)
    env.set_seed(0)
    reward = env.rollout(3)["next", "reward"]
    assert reward.shape == (2, 3, 1)
    assert reward.isfinite().all()


@pytest.mark.parametrize("name", PAPERS)
def test_a_laptop_gets_the_same_task(name, compose_config):
    """Of the task only the physics' time step may differ, and of Atalante the pushes."""
    paper, laptop = (
        compose_config(f"experiment={name}{end}", "num_envs=4").env for end in ("", "_laptop")
    )
    laptop.base_env.physics_dt = paper.base_env.physics_dt
    if name == "atalante_standing":
        assert (laptop.transforms.push.force, paper.transforms.push.force) == ([20, 20], [35, 35])
        laptop.transforms.push = paper.transforms.push
    assert laptop == paper


def test_batches_are_those_that_were_published(compose_config):
    """Steps per update, steps or sequences per minibatch."""
    sizes = {}
    for name in PAPERS:
        cfg = compose_config(f"experiment={name}")
        sizes[name] = cfg.num_envs * cfg.rollout_steps, cfg
    batch, cfg = sizes["icub_balance"]
    assert batch == pytest.approx(10_000, rel=0.01)
    assert batch / cfg.minibatches == pytest.approx(512, rel=0.03)
    batch, cfg = sizes["zeroth_fall"]
    assert cfg.num_envs / cfg.minibatches == 64
    assert cfg.rollout_steps * 0.02 == pytest.approx(2.0)  # at the 50 Hz of the public template


@pytest.mark.parametrize("name", ["atalante_standing", "atalante_standing_laptop"])
def test_atalante_is_conditioned_for_smoothness(name, compose_config):
    """L1 in time and squared L2 in space, on the mean; 100 M steps, pushes that ask for steps."""
    cfg = compose_config(f"experiment={name}")
    caps = cfg.auxiliary_losses.caps
    assert (caps.temporal_norm, caps.spatial_norm, caps.on_actions) == ("l1", "squared_l2", False)
    assert caps.temporal_coeff > 0
    assert caps.spatial_coeff > 0
    if name == "atalante_standing":
        assert cfg.total_frames == 100_000_000
        assert cfg.env.transforms.push.force == [35, 35]


def test_the_twin_is_learned_in_the_quickstart_s_world_first(compose_config):
    """What each stage leaves out; all critics see the same, so that they go on."""
    stages = {
        stage.name: stage.config for stage in stages_of(compose_config("experiment=twin_fast"))
    }
    in_twin = ["twin", "idle", "fast", "slower", "edge"]
    assert list(stages) == ["step", "steady", "calmer", "calm", "late", *in_twin]
    quick = compose_config("experiment=quickstart").env.transforms
    kept = {"push", "limit", "start", "action", "observation", "observation_critic", "terminations"}
    for key in kept:
        assert stages["step"].env.transforms[key] == quick[key], key
    hardware = {"jitter", "backlash", "physics", "encoder_late", "imu_late", "zeros", "mounting"}
    for name, cfg in stages.items():
        transforms = cfg.env.transforms
        assert cfg.env.base_env.servo_dynamics == (name in in_twin)
        there = {key for key in hardware if transforms[key] is not None}
        assert there == (hardware if name in in_twin else set())
        late = name in ("late", *in_twin)
        assert transforms.latency.delay == ([0.01, 0.035] if late else [0.0, 0.008])
        assert (cfg.augmentation is None) == (late or name == "calm")
        assert transforms.observation_critic == quick.observation_critic
    weights = [cfg.env.transforms.reward.terms.still for cfg in stages.values()]
    weights = [entry and entry[0] for entry in weights]
    assert weights == [None, None, 0.1, 0.2, 0.2, 0.2, 0.2, 0.1, 0.1, 0.1]
    assert [cfg.optimizer.lr for cfg in stages.values()] == [5e-4, 5e-4, *[3e-5] * 8]


@pytest.mark.parametrize("name", ["fast", "slower", "edge"])
def test_twice_as_many_decisions_are_worth_the_same_in_a_second(compose_config, name):
    """Rewards of a step are half as large, but for two, and discounts the square root."""
    stages = {
        stage.name: stage.config for stage in stages_of(compose_config("experiment=twin_fast"))
    }
    before, after = stages["idle"], stages[name]
    assert (before.env.base_env.control_dt, after.env.base_env.control_dt) == (0.04, 0.02)
    terms = before.env.transforms.reward.terms, after.env.transforms.reward.terms
    for key in terms[0]:
        weights, functions = zip(*(each[key] for each in terms), strict=True)
        same = key in ("fall", "action_rate")
        assert weights[1] == pytest.approx(weights[0] * (1.0 if same else 0.5)), key
        assert functions[0] == functions[1], key
    assert after.loss.gamma**2 == pytest.approx(before.loss.gamma, abs=2e-4)
    assert after.loss.lmbda**2 == pytest.approx(before.loss.lmbda, abs=2e-3)
    assert after.rollout_steps == 2 * before.rollout_steps


def test_the_twin_begins_with_all_that_twin_fast_learns(compose_config):
    """Stage by stage the same config."""
    before = stages_of(compose_config("experiment=twin_fast"))
    stages = stages_of(compose_config("experiment=twin"))[: len(before)]
    assert [stage.name for stage in stages] == [stage.name for stage in before]
    assert [stage.begins_with for stage in stages] == [stage.begins_with for stage in before]
    for stage, same in zip(stages, before, strict=True):
        assert stage.config == same.config, stage.name


@pytest.mark.parametrize(
    ("name", "teacher", "alone"),
    [
        ("twin", "stage:straighter", ["alone", "ramps", "quick"]),
        ("twin_gru_mog", "twin_fast", ["alone", "quick"]),
    ],
)
def test_a_memory_in_the_twin_is_taught_and_then_goes_on_alone(
    name, teacher, alone, compose_config
):
    """By the teacher's rate, with CAPS, noise and late commands in all stages."""
    edge = stages_of(compose_config("experiment=twin_fast"))[-1].config
    assert edge.env.base_env == load_policy("twin_fast").config.env.base_env
    stages = stages_of(compose_config(f"experiment={name}"))[-1 - len(alone) :]
    assert [stage.name for stage in stages] == ["taught", *alone]
    assert [stage.begins_with for stage in stages] == [None, "taught", *alone[:-1]]
    shown = "observation" if name == "twin" else "observation_teacher"
    for cfg in (stage.config for stage in stages):
        assert (cfg.actor.hidden_size, cfg.actor.components, cfg.actor.std) == (64, 3, 0.08)
        assert cfg.auxiliary_losses.caps == edge.auxiliary_losses.caps
        assert cfg.env.base_env == edge.env.base_env
        for key in ("latency", "noise", "encoder_late", "observation_critic", "curriculum"):
            assert cfg.env.transforms[key] == edge.env.transforms[key], key
        assert cfg.env.transforms[shown]["keys"] == edge.env.transforms.observation["keys"]
    taught, *rest = (stage.config for stage in stages)
    imitation = taught.auxiliary_losses.imitation
    assert (imitation.teacher, imitation.sees) == (teacher, shown)
    assert (taught.auxiliary_share, taught.scheduler) == (1.0, None)
    assert not any("imitation" in cfg.auxiliary_losses for cfg in rest)
    assert all(cfg.scheduler.target_kl < 0.02 for cfg in rest)


def test_ramps_of_the_servos_come_once_a_policy_goes_on_alone(compose_config):
    """In training alone, by rollouts of 0.64 s."""
    ramps = {}
    for name in ("twin", "twin_gru_mog"):
        for stage in stages_of(compose_config(f"experiment={name}")):
            planner = stage.config.env.transforms.get("planner")
            assert ("planner" in stage.config.env.training_only) == (planner is not None)
            if planner is not None:
                ramps[name, stage.name] = planner.acceleration
                assert stage.config.rollout_steps == 32
    assert ramps == {
        ("twin", "ramps"): [30.0, 150.0],
        ("twin", "quick"): [30.0, 600.0],
        ("twin_gru_mog", "alone"): [30.0, 150.0],
        ("twin_gru_mog", "quick"): [30.0, 600.0],
    }


def test_the_memory_in_the_twin_is_taught_in_the_pose_in_which_it_is_to_rest(compose_config):
    """The stage before moves edge by the offsets that the reward asks for from then on."""
    stages = stages_of(compose_config("experiment=twin"))
    names = [stage.name for stage in stages]
    moved = names.index("straighter")
    assert names[moved - 1 :] == ["edge", "straighter", "taught", "alone", "ramps", "quick"]
    assert stages[moved].make["run"] == "stage:edge"
    for stage in stages:
        terms = stage.config.env.transforms.reward.terms
        assert ("rest" in terms) == (stage.number > moved + 1), stage.name
        if "rest" in terms:
            assert terms.rest[1].offsets == stages[moved].make["offsets"]
            assert set(terms.rest[1].joints) == set(terms.rest[1].offsets)


def test_what_has_to_remember_is_shown_neither_joint_speeds_nor_its_targets(compose_config):
    """Only where gravity is, how the trunk turns and where the joints are; so what ships."""
    configs = [stage.config for stage in stages_of(compose_config("experiment=twin_gru_mog"))]
    for cfg in (*configs, load_policy("twin_gru_mog").config):
        seen = cfg.env.transforms.observation["keys"]
        assert seen == ["projected_gravity", "base_angular_velocity", "joint_position"]
