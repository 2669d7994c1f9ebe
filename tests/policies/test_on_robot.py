"""What runs on the robot's computer gives the targets of the policy in its env."""

import pytest
import torch
from torchrl.envs import ExplorationType, set_exploration_type, step_mdp
from torchrl.modules.utils import get_primers_from_module

from zfall.envs.transforms.estimation import JointVelocityKalmanFilter, TiltKalmanFilter
from zfall.envs.transforms.observations.measured import read_measured
from zfall.evaluation.battery import battery_env
from zfall.evaluation.candidate import load_candidate
from zfall.evaluation.definitions import load_battery
from zfall.modules.actors import recurrent_keys
from zfall.policies.on_robot import RobotPolicy, plain_name, software


def robot_of_run(name: str, battery: str):
    """The env of a policy in a battery, the policy, and its form for a robot."""
    candidate = load_candidate(name)
    env, _, _ = battery_env(load_battery(battery), candidate.env_cfg, 1)
    own, _, _ = battery_env(load_battery("planar"), candidate.env_cfg, 1)
    policy = RobotPolicy(own, candidate.actor).eval()
    if recurrent_keys(candidate.actor):
        env.append_transform(get_primers_from_module(candidate.actor))
    return env, candidate.actor, policy


def switched_on(env, td):
    """The env's estimators begin as those of a robot do, which does not know the truth."""
    for transform in env.transform:
        if isinstance(transform, TiltKalmanFilter):
            up = read_measured(td, "base_acceleration")
            x, y, z = up.unbind(-1)
            angle = torch.stack([torch.atan2(y, z), torch.atan2(-x, torch.hypot(y, z))], -1)
            transform.state = torch.stack([angle, torch.zeros_like(angle)], -1)
            transform._write(td)
        if isinstance(transform, JointVelocityKalmanFilter):
            transform.state[..., 0] = read_measured(td, "joint_position")
            transform.state[..., 1] = 0.0
            td["measured", "joint_velocity"] = transform.state[..., 1].clone()
    for transform in env.transform:
        if "observation" in (transform.out_keys or ()):
            transform._call(td)
    return td


@pytest.mark.parametrize(
    ("name", "battery"),
    [
        ("best_gru", "planar"),  # positions, several hidden states
        ("twin", "twin"),  # estimators, in the world of the twin
        ("zeroth_fall", "planar"),  # a mixture, a command
        ("atalante", "planar"),  # velocities with their ticks
        ("icub", "planar"),  # velocities, quantities in units of their ranges
    ],
)
def test_targets_are_those_of_the_policy_step_by_step(name, battery, monkeypatch):
    """Two seconds in which each has its own states: targets and hidden states stay the same."""
    env, actor, policy = robot_of_run(name, battery)
    states, begin, worst, moved = policy.starts, torch.ones(1, 1), 0.0, 0.0
    base, given = env.base_env, []
    steps = type(base)._step
    monkeypatch.setattr(
        type(base),
        "_step",
        lambda self, td: (given.append(td.get("control", None)), steps(self, td))[1],
    )
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        td = switched_on(env, env.reset())
        first = td["target"].clone()
        for _ in range(round(2.0 / env.base_env.control_dt)):
            known = [read_measured(td, key).reshape(1, -1) for key in policy.sensors]
            _, command, *after = policy(begin, *known, *states.values())
            states = dict(zip(states, after, strict=True))
            td = env.step(actor(td))
            target = td["next", "target"]
            worst = max(worst, float((states["target"] - target).abs().max()))
            moved = max(moved, float((target - first).abs().max()))
            if battery == "planar" and given[-1] is not None:  # of each physics step, with no delay
                ticks = command.repeat_interleave(base.substeps // command.shape[1], 1)
                assert torch.allclose(ticks, given[-1].expand_as(ticks), atol=1e-4)
            for key in recurrent_keys(actor):
                hidden = states["memory"] if "memory" in states else states[plain_name(key)]
                assert torch.allclose(hidden, td["next", key], atol=1e-4)
            td, begin = step_mdp(td), torch.zeros(1, 1)
    assert worst < 1e-4
    assert moved > 0.02  # the policy does something


def test_what_only_simulates_the_world_stays_behind():
    """In the twin's own env the robot needs encoders, gyro and accelerometer alone."""
    candidate = load_candidate("twin")
    env, _, _ = battery_env(load_battery("twin"), candidate.env_cfg, 1)
    steps, sensors = software(env)
    assert set(sensors) == {"joint_position", "base_angular_velocity", "base_acceleration"}
    names = {name for step in steps for name in step.states}
    assert names == {"target", "tilt_filter", "last_rate", "joint_velocity_filter"}
