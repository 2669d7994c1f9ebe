"""Forces integrate to momentum: p = J, L = r x J, on a rigid block and on the robot, in the air."""

from itertools import pairwise

import pytest
import torch
from torch.testing import assert_close

from tests.block import MASS, block_robot, inertia
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.pushes import ScriptedPush
from zfall.robots import ZEROTH01

# Mean of each profile; of a Gaussian cut at 3 sigma: sqrt(2 pi) erf(3 / sqrt(2)) / 6.
SHARE = {"rectangular": 1.0, "half_sine": 2 / torch.pi, "ramp": 0.5,
         "gaussian": (2 * torch.pi) ** 0.5 * 0.9973002039367398 / 6}  # fmt: skip
RATES = [(0.04, 0.004), (0.02, 0.004), (0.01, 0.0025), (0.035, 0.005)]


def floating(robot, control_dt: float, physics_dt: float, **push):
    base = HumanoidEnv(num_envs=1, control_dt=control_dt, physics_dt=physics_dt, robot=robot)
    base.simulation.model.opt.gravity[:] = 0
    action = JointPositionTarget(base, scale=1.0)
    return make_env(base, {"action": action, "push": ScriptedPush(base, **push)})


def after_push(env, seconds: float):
    td = env.reset()
    env.base_env.simulation.qpos[:, 2] = 5.0
    for _ in range(round(seconds / env.control_dt)):
        td["action"] = torch.zeros(env.full_action_spec["action"].shape)
        td = env.step(td)["next"]
    return td


@pytest.mark.parametrize("profile", ["rectangular", "half_sine", "gaussian", "ramp"])
@pytest.mark.parametrize(("control_dt", "physics_dt"), RATES)
def test_a_free_block_gains_the_impulse(tmp_path, profile, control_dt, physics_dt):
    """v = J / m to 1e-5, and no turn, for a push at the center of mass."""
    push = {"point": "torso", "duration": 0.11, "time": 0.053, "plan": [6.0, -3.0, 2.0]}
    env = floating(block_robot(tmp_path), control_dt, physics_dt, profile=profile, **push)
    td = after_push(env, 0.28)
    expected = SHARE[profile] * 0.11 * torch.tensor([[6.0, -3.0, 2.0]])
    assert_close(td["linear_momentum"], expected, rtol=1e-5, atol=1e-6)
    assert_close(MASS * td["base_linear_velocity"], expected, rtol=1e-5, atol=1e-6)
    assert td["angular_momentum"].abs().max() < 1e-6


@pytest.mark.parametrize("profile", ["rectangular", "half_sine", "gaussian", "ramp"])
@pytest.mark.parametrize(("control_dt", "physics_dt"), RATES)
def test_off_its_center_a_free_block_gains_the_moment_of_the_impulse(
    tmp_path, profile, control_dt, physics_dt
):
    """So weak a push that the lever does not turn: L = r x J to 1e-5, omega = L / I."""
    push = {"point": "corner", "duration": 0.11, "time": 0.053, "plan": [2e-4, 0.0, 0.0]}
    env = floating(block_robot(tmp_path), control_dt, physics_dt, profile=profile, **push)
    td = after_push(env, 0.28)
    impulse = SHARE[profile] * 0.11 * torch.tensor([[2e-4, 0.0, 0.0]])
    moment = torch.linalg.cross(torch.tensor([[0.04, 0.03, 0.1]]), impulse)
    assert_close(td["linear_momentum"], impulse, rtol=1e-5, atol=1e-10)
    assert_close(td["angular_momentum"], moment, rtol=1e-5, atol=1e-10)
    spin = moment / torch.tensor([inertia()])
    assert_close(td["base_angular_velocity"], spin, rtol=1e-4, atol=1e-8)


def test_the_floating_robot_gains_the_impulse_and_the_error_is_proportional_to_the_physics_step():
    push = {"point": "chest", "duration": 0.1, "time": 0.05, "plan": [12.0, 6.0, 0.0]}
    errors = []
    for physics_dt in (0.004, 0.002, 0.001):
        td = after_push(floating(ZEROTH01, 0.04, physics_dt, **push), 0.2)
        expected = torch.tensor([[1.2, 0.6, 0.0]])
        errors.append(((td["linear_momentum"] - expected).norm() / expected.norm()).item())
    assert errors[0] < 0.03
    for coarse, fine in pairwise(errors):
        assert fine == pytest.approx(0.5 * coarse, rel=0.05)
