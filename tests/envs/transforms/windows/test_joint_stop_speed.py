"""Speeds at the stops: made up, and of a joint that runs into one."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.starts import ScriptedStart
from zfall.envs.transforms.windows import JointStopSpeed

ELBOW = 14  # left, its stops at -0.872665 and 1.570796 rad


def test_only_joints_at_a_stop_count_and_the_fastest_of_them(make_base):
    base = make_base(num_envs=4)
    position, velocity = base.stand_position.repeat(4, 10, 1), torch.zeros(4, 10, 20)
    velocity[:, :, 3] = 9.0  # of a knee between its stops
    position[1, 4, ELBOW], velocity[1, 4, ELBOW] = 1.5708, 2.0
    position[2, 5:7, ELBOW], velocity[2, 5:7, ELBOW] = -0.8727, torch.tensor([-0.7, 0.3])
    position[3, 0, ELBOW], velocity[3, 0, ELBOW] = 1.5707, 2.0  # just before it
    td = TensorDict({"substeps": {"joint_position": position, "joint_velocity": velocity}}, [4])
    found = JointStopSpeed(base)._call(td)["joint_stop_speed"]
    assert_close(found, torch.tensor([[0.0], [2.0], [0.7], [0.0]]))


@pytest.mark.parametrize("speed", [1.0, 1.6, 2.4])
def test_joint_that_runs_into_its_stop_hits_it_with_what_its_damping_left(speed):
    """``I dv/dt = -d v - f``: over 5 mrad v falls by about (d + f / v) 0.005 / I.

    Without gravity and servos nothing else acts; I is the inertia of servo and forearm.
    """
    base = HumanoidEnv(num_envs=1, control_dt=0.04, physics_dt=0.0002, powered=False)
    base.simulation.model.opt.gravity[:] = 0
    angle, rate = base.stand_position.clone(), torch.zeros(20)
    angle[ELBOW], rate[ELBOW] = 1.570796 - 0.005, speed
    up = torch.tensor([[0.0, 0.0, 5.0]])
    states = {"joint_position": angle[None], "joint_velocity": rate[None], "base_position": up}
    env = make_env(base, {
        "start": ScriptedStart(base, states=states),
        "action": JointPositionTarget(base, scale=1.0),
        "stop": JointStopSpeed(base),
    })  # fmt: skip
    td = env.reset()
    assert td["joint_stop_speed"].item() == 0.0
    td["action"] = torch.zeros(1, 20)
    found = env.step(td)["next", "joint_stop_speed"].item()
    inertia = 0.04 + 0.0006  # armature and forearm [kg m2]
    lost = (1.2305 + 0.162 / speed) * 0.005 / inertia
    assert found == pytest.approx(speed - lost, abs=0.02)


def test_specs_hold(make_task):
    check_env_specs(make_task({
        "action": (JointPositionTarget, {"scale": 1.0}),
        "stop": (JointStopSpeed, {}),
    }))  # fmt: skip
