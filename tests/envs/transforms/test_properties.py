"""What holds for every transform and every table of them."""

import copy
import re
from pathlib import Path

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch.testing import assert_close
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs, step_mdp

from zfall.envs import transforms
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.robots import Ball

_ACTIONS, _PUSHES = "zfall.envs.transforms.actions", "zfall.envs.transforms.pushes"
_SENSING, _RANDOM = "zfall.envs.transforms.observations", "zfall.envs.transforms.randomization"
_TERMS = "zfall.envs.terms"
_ESTIMATION, _WINDOWS = "zfall.envs.transforms.estimation", "zfall.envs.transforms.windows"
TARGETS = {
    "position": {"_target_": f"{_ACTIONS}.JointPositionTarget", "scale": 0.6},
    "velocity": {"_target_": f"{_ACTIONS}.JointVelocityTarget", "limit": 3.0, "rate": 125},
}
IMU = ["projected_gravity", "base_angular_velocity"]
TABLE = {  # in the order of a yaml
    "start": {
        "_target_": "zfall.envs.transforms.starts.NoisyStart",
        "joint_position": 0.05,
        "joint_velocity": 0.2,
    },
    "reference": {
        "_target_": "zfall.envs.transforms.starts.ReferenceStart",
        "motions": ["forward_0.10", "turn_left_0.5"],
        "joint_position": 0.05,
        "heading": True,
    },
    "falling": {"_target_": "zfall.falling.falling_start.FallingStart", "share": 0.5},
    "kneel_reference": {"_target_": "zfall.falling.kneel_reference.KneelReference"},
    "stable": {"_target_": "zfall.falling.modes.StableHold"},
    "planner": {"_target_": f"{_ACTIONS}.ServoPlanner"},
    "deadband": {"_target_": f"{_ACTIONS}.Deadband", "width": 0.01},
    "backlash": {"_target_": f"{_ACTIONS}.Backlash", "width": 0.02},
    "low_pass": {"_target_": f"{_ACTIONS}.LowPass", "time_constant": 0.02},
    "delay": {"_target_": f"{_ACTIONS}.ActuatorDelay", "delay": [0.0, 0.03]},
    "jitter": {
        "_target_": f"{_ACTIONS}.ActuatorDelay",
        "delay": [0.0, 0.01],
        "per": "step",
        "joints": "own",
    },
    "push": {
        "_target_": f"{_PUSHES}.RandomPush",
        "point": ["torso", "pelvis"],
        "size": [0.1, 0.6],
        "duration": [0.05, 0.15],
        "mean_interval": 0.4,
        "direction": "spherical",
        "profile": "gaussian",
    },
    "timed": {
        "_target_": f"{_PUSHES}.RandomPush",
        "point": "torso",
        "size": [0.1, 0.2],
        "duration": 0.08,
        "times": [0.04, 0.2, 0.36],
    },
    "script": {
        "_target_": f"{_PUSHES}.ScriptedPush",
        "point": "chest",
        "duration": 0.1,
        "time": [0.1],
        "plan": [[3.0, 2.0, 0.0]],
    },
    "kick": {
        "_target_": f"{_PUSHES}.VelocityKick",
        "velocity": [0.1, 0.3],
        "times": [0.1, 0.2, 0.3],
    },
    "ball": {"_target_": f"{_PUSHES}.ThrownBall", "speed": [3, 4], "times": [0.1, 0.3]},
    "random": {
        "_target_": f"{_RANDOM}.DomainRandomization",
        "interval": 0.12,
        "params": {
            "link_mass": {"uniform": [0.9, 1.1]},
            "foot_friction": {"log_uniform": [0.5, 1.5]},
            "joint_zero_offset": {"normal": [0.0, 0.02]},
            "slope": {"uniform": [-0.05, 0.05]},
        },
    },
    "command": {
        "_target_": "zfall.envs.transforms.commands.Command",
        "ranges": {"vx": [-0.1, 0.3], "height": [-0.02, 0.0]},
        "interval": [0.08, 0.2],
    },
    "last_action": {"_target_": f"{_WINDOWS}.LastAction"},
    "mean": {"_target_": f"{_WINDOWS}.MeanVelocity"},
    "momentum": {"_target_": f"{_WINDOWS}.MomentumRate"},
    "gone": {"_target_": f"{_WINDOWS}.OdometryDisplacement", "seconds": 0.2},
    "error": {"_target_": f"{_WINDOWS}.JointErrorMin", "seconds": 0.16},
    "shock": {
        "_target_": f"{_WINDOWS}.LargestSoFar",
        "keys": {"base_acceleration_peak": "base_acceleration_max"},
    },
    "explore": {
        "_target_": "zfall.envs.transforms.exploration.CorrelatedNoise",
        "correlation": 0.8,
    },
    "stop": {"_target_": f"{_WINDOWS}.JointStopSpeed"},
    "power": {"_target_": f"{_WINDOWS}.JointPower"},
    "air_time": {"_target_": f"{_WINDOWS}.FeetAirTime"},
    "effort": {"_target_": f"{_WINDOWS}.JointEffort"},
    "fall": {
        "_target_": "zfall.envs.transforms.terminations.Terminations",
        "conditions": {
            "low": {
                "_target_": "zfall.envs.terms.falls.low",
                "_partial_": True,
                "height": 0.1,
            }
        },
    },
    "reward": {
        "_target_": "zfall.envs.transforms.rewards.WeightedReward",
        "terms": {
            "effort": [-0.1, {"_target_": f"{_TERMS}.effort.joint_torque", "_partial_": True}],
            "rate": [-0.1, {"_target_": f"{_TERMS}.effort.action_rate", "_partial_": True}],
        },
    },
    "limit": {"_target_": "torchrl.envs.StepCounter", "max_steps": 9},
    "curriculum": {
        "_target_": "zfall.envs.transforms.curriculum.Curriculum",
        "up": 0.3,
        "fields": {"start.joint_position": [0.05, 0.1]},
    },
    "late": {"_target_": f"{_SENSING}.ObservationDelay", "delay": [0.0, 0.05], "keys": IMU},
    "zero": {"_target_": f"{_RANDOM}.JointZeroOffset"},
    "askew": {"_target_": f"{_RANDOM}.ImuMisalignment", "angle": 0.03, "keys": IMU},
    "bias": {"_target_": f"{_SENSING}.ObservationBias", "std": {"base_angular_velocity": 0.02}},
    "walk": {"_target_": f"{_SENSING}.ObservationRandomWalk", "rate": {IMU[1]: 0.01}},
    "noise": {
        "_target_": f"{_SENSING}.ObservationNoise",
        "std": {"joint_position": 0.01},
        "uniform": {"projected_gravity": 0.01},
    },
    "bits": {"_target_": f"{_SENSING}.Quantization", "step": {"joint_position": 0.0015}},
    "lost": {
        "_target_": f"{_SENSING}.ObservationDropout",
        "probability": 0.2,
        "keys": ["joint_position"],
    },
    "predictor": {
        "_target_": "zfall.falling.modes.FallPredictor",
        "network": {"_target_": "zfall.falling.fall_network.FallNetwork", "size": 6},
        "keys": IMU,
    },
    "mode": {"_target_": "zfall.falling.modes.ModeMachine", "hold": 0.08, "back": 0.08},
    "tilt": {"_target_": f"{_ESTIMATION}.TiltKalmanFilter"},
    "angles": {"_target_": f"{_SENSING}.TiltAngles"},
    "differences": {"_target_": f"{_ESTIMATION}.NumericalVelocity"},
    "speed": {"_target_": f"{_ESTIMATION}.JointVelocityKalmanFilter"},
    "base_pose": {"_target_": f"{_SENSING}.BasePose"},
    "feet": {"_target_": f"{_SENSING}.FeetInBase"},
    "imu": {"_target_": f"{_SENSING}.ImuOrientation"},
    "observation": {
        "_target_": f"{_SENSING}.ObservationVector",
        "out_key": "observation",
        "measured": True,
        "keys": [*IMU, "joint_position", "joint_velocity"],
    },
    "normalized": {
        "_target_": f"{_SENSING}.NormalizedVector",
        "out_key": "observation_critic",
        "keys": ["joint_position", "base_position"],
        "ranges": {"joint_position": "joint_range", "base_position": [0.0, 2.0]},
    },
    "mirrored_falls": {"_target_": "zfall.falling.mirrored_falls.MirroredFalls"},
    "near": {"_target_": f"{_SENSING}.CAPSNeighbours", "sigma": 0.1},
}
TABLES = st.tuples(
    st.sampled_from(list(TARGETS)),
    st.sets(st.sampled_from(list(TABLE)), min_size=1).map(lambda names: names | {"limit"}),
)
# Some measure the same; each goes with one kind of target.
OF_TARGET = {"position": {"tilt", "speed"}, "velocity": {"angles", "differences"}}
ELSEWHERE = {"ScriptedStart"}  # of Python alone, see test_starts.py
EVERYTHING = ("position", set(TABLE))


def build(table: tuple[str, set[str]], num_envs: int = 4) -> TransformedEnv:
    target, names = table
    if "curriculum" in names:
        names = names | {"start"}
    if target == "velocity":
        names = names - {"kneel_reference", "mirrored_falls"}  # change position targets alone
    if "mirrored_falls" in names:
        names = names | {"kneel_reference"}
    if names & {"stable", "kneel_reference"}:
        names = names | {"mode"}
    if "zero" in names:
        names = names | {"random"}
    if "reward" in names:
        names = names | {"last_action"}
    if "near" in names:
        names = names | {"observation"}
    names = names - (set.union(*OF_TARGET.values()) - OF_TARGET[target])
    base = HumanoidEnv(num_envs=num_envs, control_dt=0.04, ball=Ball(mass=0.2, radius=0.03))
    chosen = {name: TABLE[name] for name in TABLE if name in names}
    torch.manual_seed(0)  # of the networks that transforms bring
    env = make_env(base, {"action": TARGETS[target]} | copy.deepcopy(chosen))
    env.set_seed(0)
    return env


def run(env: TransformedEnv, td, steps: int, seed: int):
    """Random actions, episodes that end and begin; the data and what goes on from them."""
    generator, seen = torch.Generator().manual_seed(seed), []
    for _ in range(steps):
        td["action"] = 0.5 * torch.randn(env.num_envs, 20, generator=generator)
        data, td = env.step_and_maybe_reset(td)
        seen.append(data["next"].clone())
    return seen, td


def equal(one, other, rows=slice(None)) -> None:
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    for key in one.keys(True, True):
        assert torch.equal(one[key][rows], other[key][rows]), key


def test_no_transform_is_missing_here():
    folder = Path(transforms.__file__).parent
    texts = (path.read_text() for path in folder.rglob("*.py"))
    there = {
        name for text in texts for name in re.findall(r"^class (\w+)\(Transform\)", text, re.M)
    }
    built = {type(t).__name__ for target in TARGETS for t in build((target, set(TABLE))).transform}
    assert len(there) > 40
    assert there <= built | ELSEWHERE


@settings(max_examples=10, deadline=None, derandomize=True)
@given(TABLES)
def test_specs_hold(table):
    check_env_specs(build(table))


def test_specs_hold_with_everything_on():
    for target in TARGETS:
        check_env_specs(build((target, set(TABLE))))


@settings(max_examples=10, deadline=None, derandomize=True)
@given(TABLES, st.lists(st.booleans(), min_size=4, max_size=4).filter(any), st.integers(0, 99))
@example(EVERYTHING, [True, False, True, False], 0)
@example(("velocity", set(TABLE)), [False, False, True, False], 1)
def test_partial_reset_equals_full_reset_on_its_rows(table, mask, seed):
    """Two equal envs, one reset in full, the other in some rows: those rows stay equal.

    Levels of the curriculum move with the ends of episodes, so both envs end the same ones.
    """
    env, other = build(table), build(table)
    starts = []
    for one, rows in ((env, [True] * 4), (other, mask)):
        _, td = run(one, one.reset(), 5, seed)
        td["_reset"] = torch.tensor(rows)[:, None]
        starts.append(one.reset(td).exclude("_reset", "action"))
    rows = torch.tensor(mask)
    equal(starts[0], starts[1], rows)
    seen = [run(one, td, 4, seed)[0] for one, td in zip((env, other), starts, strict=True)]
    for one, two in zip(*seen, strict=True):
        equal(one, two, rows)
        if not torch.equal(one["done"], two["done"]):
            break  # one has drawn for a reset that the other does not have


@settings(max_examples=10, deadline=None, derandomize=True)
@given(TABLES, st.integers(1, 12), st.integers(0, 99))
def test_a_restored_env_goes_on_bit_for_bit(table, steps, seed):
    check_restored(table, steps, seed)


@pytest.mark.parametrize("steps", [3, 11])
def test_a_restored_env_goes_on_bit_for_bit_with_everything_on(steps):
    check_restored(EVERYTHING, steps, seed=1)


def check_restored(table, steps: int, seed: int) -> None:
    env, other = build(table), build(table)
    _, td = run(env, env.reset(), steps, seed)
    base, transforms, carrier = env.base_env.state_dict(), env.transform.state_dict(), td.clone()
    expected, _ = run(env, td, 10, seed + 1)
    run(other, other.reset(), 2, seed + 2)  # somewhere else by now
    other.base_env.load_state_dict(base)
    other.transform.load_state_dict(transforms)
    found, _ = run(other, carrier, 10, seed + 1)
    for one, two in zip(expected, found, strict=True):
        equal(one, two)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(st.permutations(["planner", "backlash", "low_pass", "delay"]))
def test_the_order_of_the_table_is_the_order_of_data(order):
    """Commands through the chain at once equal those through each transform on its own."""
    base = HumanoidEnv(num_envs=2, control_dt=0.04)
    env = make_env(base, {"action": TARGETS["position"]} | {name: TABLE[name] for name in order})
    alone = [make_env(HumanoidEnv(num_envs=2, control_dt=0.04), {"a": TABLE[n]}) for n in order]
    seen: list[torch.Tensor] = []
    step = base._step
    base._step = lambda td: seen.append(td["control"].clone()) or step(td)
    env.set_seed(0)
    td = env.reset()
    for one in alone:
        one.reset()
    delay = next(t for t in env.transform if hasattr(t, "lag"))
    twin = next(one.transform[0] for one, n in zip(alone, order, strict=True) if n == "delay")
    twin.lag = delay.lag.clone()
    for _ in range(4):
        td["action"] = torch.randn(2, 20)
        data, td = env.step_and_maybe_reset(td)
        command = data["next"].select("target")
        for one in alone:
            command = one.transform[0]._inv_call(command)
        assert_close(seen[-1], command["control"])


def test_nothing_that_belongs_to_one_step_stays_for_the_next():
    """A wrench that stayed would be added to again."""
    env = build(EVERYTHING)
    td = env.reset()
    td["action"] = torch.zeros(4, 20)
    following = step_mdp(env.step(td))
    assert ("push", "wrench") not in following.keys(True)
    assert "control" not in following.keys()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("steps", [5, 12])
@pytest.mark.parametrize("mask", [[True] * 4, [True, False, True, False]])
def test_a_reset_forgets_all_that_was_before(target, steps, mask):
    """Rows reset equal those of an env newly built, from the same random numbers on.

    All but the curriculum, whose levels outlive episodes.
    """
    table = target, set(TABLE) - {"curriculum"}
    used, new = build(table), build(table)
    _, td = run(used, used.reset(), steps, seed=3)
    new.base_env.rng.set_state(used.base_env.rng.get_state())
    rows = torch.tensor(mask)
    td["_reset"] = rows[:, None]
    begun = used.reset(td).exclude("_reset", "action"), new.reset()
    equal(*begun, rows)
    for one, two in zip(
        *(run(e, td, 8, 5)[0] for e, td in zip((used, new), begun, strict=True)), strict=True
    ):
        equal(one, two, rows)
        if not torch.equal(one["done"], two["done"]):
            break  # one has drawn for a reset that the other does not have
