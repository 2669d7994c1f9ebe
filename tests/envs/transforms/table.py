"""Every transform of the project as a row of yaml, and envs of any rows of them."""

import copy
from typing import Any

import torch
from torchrl.envs import TransformedEnv

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.robots import ZEROTH01, Ball, Robot

_ACTIONS, _PUSHES = "zfall.envs.transforms.actions", "zfall.envs.transforms.pushes"
_SENSING, _RANDOM = "zfall.envs.transforms.observations", "zfall.envs.transforms.randomization"
_TERMS, _FOREIGN = "zfall.envs.terms", "zfall.envs.transforms.foreign.terms"
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
    "rise_reference": {"_target_": "zfall.falling.rise_reference.RiseReference"},
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
    "ball_push": {"_target_": f"{_PUSHES}.BallPush", "flight": 0.1},
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
        "ranges": {"vx": [-0.1, 0.3], "yaw": [-1.0, 1.0], "height": [-0.02, 0.0]},
        "interval": [0.08, 0.2],
        "turning": True,
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
    "average": {
        "_target_": f"{_WINDOWS}.MovingAverage",
        "keys": {"joint_torque": "mean_joint_torque"},
        "seconds": 0.5,
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
    "mode": {
        "_target_": "zfall.falling.modes.ModeMachine",
        "hold": 0.08,
        "back": 0.08,
        "rise": 0.08,
    },
    "tilt": {"_target_": f"{_ESTIMATION}.TiltKalmanFilter"},
    "up": {"_target_": f"{_ESTIMATION}.MahonyFilter"},
    "angles": {"_target_": f"{_SENSING}.TiltAngles"},
    "differences": {"_target_": f"{_ESTIMATION}.NumericalVelocity"},
    "speed": {"_target_": f"{_ESTIMATION}.JointVelocityKalmanFilter"},
    "base_pose": {"_target_": f"{_SENSING}.BasePose"},
    "feet": {"_target_": f"{_SENSING}.FeetInBase"},
    "imu": {"_target_": f"{_SENSING}.ImuOrientation"},
    "imu_to_heading": {"_target_": f"{_SENSING}.OrientationToHeading"},
    "history": {
        "_target_": f"{_SENSING}.ObservationHistory",
        "keys": [IMU[0], "joint_position"],
        "steps": 2,
    },
    "observation": {
        "_target_": f"{_SENSING}.ObservationVector",
        "out_key": "observation",
        "measured": True,
        "keys": [*IMU, "joint_position", "joint_velocity"],
    },
    "foreign": {
        "_target_": "zfall.envs.transforms.foreign.ForeignObservation",
        "joints": sorted(ZEROTH01.joints),
        "terms": [
            {"of": {"_target_": f"{_FOREIGN}.JointPosition"}, "scale": 0.5},
            {"of": {"_target_": f"{_FOREIGN}.PreviousAction"}, "clip": [-1.0, 1.0]},
            {"of": {"_target_": f"{_FOREIGN}.GaitClock", "frequency": 1.5}},
        ],
        "history": 2,
        "out_key": "foreign",
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
# Some measure the same; each goes with one kind of target.
OF_TARGET = {"position": {"tilt", "up", "speed"}, "velocity": {"angles", "differences"}}
NEEDS = {  # other rows that a row cannot be without
    "curriculum": {"start"},
    "kneel_reference": {"mode"},
    "mirrored_falls": {"kneel_reference", "mode"},
    "near": {"observation"},
    "reward": {"last_action"},
    "rise_reference": {"mode"},
    "imu_to_heading": {"command"},
    "stable": {"mode"},
    "zero": {"random"},
}
OF_POSITION = {
    "kneel_reference",
    "mirrored_falls",
    "rise_reference",
}  # change position targets alone


def choose(target: str, names: set[str]) -> dict[str, Any]:
    """The table of these rows and those that they need, for one kind of target."""
    names = names - OF_POSITION if target == "velocity" else names
    names = names.union(*(NEEDS.get(name, set()) for name in names))
    names = names - (set.union(*OF_TARGET.values()) - OF_TARGET[target])
    names = names - {"up"} if "tilt" in names else names  # the same, too
    chosen = {name: TABLE[name] for name in TABLE if name in names}
    return copy.deepcopy({"action": TARGETS[target]} | chosen)


def build_base(num_envs: int = 4, robot: Robot = ZEROTH01) -> HumanoidEnv:
    ball = Ball(mass=0.2, radius=0.03)
    return HumanoidEnv(num_envs=num_envs, control_dt=0.04, ball=ball, robot=robot)


def build(
    table: tuple[str, set[str]], num_envs: int = 4, robot: Robot = ZEROTH01, **files: str
) -> TransformedEnv:
    """An env with these rows, for one kind of target, of a robot with its own bank and catches."""
    base, rows = build_base(num_envs, robot), choose(*table)
    for name, row in (("falling", "bank"), ("kneel_reference", "catches")):
        if row in files and name in rows:
            rows[name][row] = files[row]
    if "foreign" in rows:
        rows["foreign"]["joints"] = sorted(robot.joints)
    torch.manual_seed(0)  # of the networks that transforms bring
    env = make_env(base, rows)
    env.set_seed(0)
    return env
