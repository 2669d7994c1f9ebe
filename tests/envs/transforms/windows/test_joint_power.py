"""Power by hand, of a steady motion, and against the energy it becomes."""

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointVelocityTarget
from zfall.envs.transforms.windows import JointPower

KNEE, SHOULDER, ELBOW = 9, 12, 14  # left


def test_power_by_hand(make_base):
    """A knee at 2 rad/s with 4 N m: (4 - 1.34640385 2) 2 - 0.2 2 = 2.21438 W, the other way round too.

    With 4 N m in half of the physics steps: 8 W less in the others. Braking with 4 N m it takes
    (-4 - 2.69281) 2 - 0.4 = -13.78562 W, again 8 W apart. Speeding up from rest in the first step
    of ten, its mean velocity is 1 rad/s there: (4 - 2.69281) 1 - 0.2 = 1.10719 W.
    """
    base = make_base(num_envs=4)
    power = JointPower(base)
    torque, velocity = torch.zeros(4, 10, 20), torch.zeros(4, 10, 20)
    torque[:3, ::2, KNEE], torque[3, :, KNEE], velocity[:, :, KNEE] = 4.0, 4.0, 2.0
    torque[1] *= -1
    velocity[1:3] *= -1
    before = TensorDict({"joint_velocity": velocity[:, 0].clone()}, [4])
    before["joint_velocity"][3] = 0.0
    td = TensorDict({"substeps": {"joint_torque": torque, "joint_velocity": velocity}}, [4])
    expected = torch.tensor([[2.21438 - 4], [2.21438 - 4], [-13.78562 + 4], [2.21438 - 0.110719]])
    assert_close(power._step(before, td.clone())["power"], expected, atol=1e-4, rtol=0)
    rows = torch.tensor([True, False, False, False])
    base.set_physics_params(TensorDict({"joint_damping": torch.full((4, 20), 0.5)}, [4]), rows)
    own = power._step(before, td)["power"]  # half the damping: 2.69281 W less of loss
    assert_close(own[0], expected[0] + 2.69281, atol=1e-4, rtol=0)
    assert_close(own[1:], expected[1:], atol=1e-4, rtol=0)


def floating(physics_dt: float, limit: float) -> tuple[HumanoidEnv, object]:
    """A robot high up, without gravity: its servos are all that acts."""
    base = HumanoidEnv(num_envs=2, control_dt=0.04, physics_dt=physics_dt)
    base.simulation.model.opt.gravity[:] = 0
    action = JointVelocityTarget(base, limit=limit)
    env = make_env(base, {"action": action, "power": JointPower(base)})
    env.set_seed(0)
    td = env.reset()
    base.simulation.qpos[:, 2] = 5.0
    return env, td


def kinetic_energy(base: HumanoidEnv) -> np.ndarray:
    """Of all links and motors ``(N,)`` [J]."""
    model, data = base.simulation.model, mujoco.MjData(base.simulation.model)
    energy = []
    for qpos, qvel in zip(base.simulation.qpos, base.simulation.qvel, strict=True):
        data.qpos[:], data.qvel[:] = qpos.numpy(), qvel.numpy()
        mujoco.mj_forward(model, data)
        mujoco.mj_energyVel(model, data)
        energy.append(data.energy[1])
    return np.array(energy)


@pytest.mark.parametrize("physics_dt", [0.005, 0.001])
def test_what_the_joints_put_out_becomes_kinetic_energy(physics_dt):
    """Random targets for 0.8 s; the balance holds at every control step, of sizes up to 1 J."""
    env, td = floating(physics_dt, limit=3.0)
    before, largest = kinetic_energy(env.base_env), 0.0
    for _ in range(20):
        td["action"] = 0.7 * torch.randn(2, 20)
        td = env.step(td)["next"]
        after = kinetic_energy(env.base_env)
        work = 0.04 * td["power"][:, 0].numpy()
        np.testing.assert_allclose(work, after - before, atol=0.02 * max(after.max(), 0.05))
        before, largest = after, max(largest, after.max())
    assert largest > 0.1


def test_a_steady_turn_without_a_load_takes_no_power():
    """The servo's whole torque goes into damping and friction: 1.9 W of its own per arm joint."""
    env, td = floating(0.005, limit=1.0)
    action = torch.zeros(2, 20)
    action[:, SHOULDER] = 1.0
    for _ in range(25):
        td["action"] = action
        td = env.step(td)["next"]
    speed, torque = td["joint_velocity"][0, SHOULDER], td["joint_torque"][0, SHOULDER]
    assert speed.item() == pytest.approx(1.0, abs=0.05)
    assert (torque * speed).item() == pytest.approx(1.3464 + 0.2, rel=0.05)
    assert td["power"][0].item() == pytest.approx(0.0, abs=0.05)


def test_specs_hold_and_a_reset_begins_with_none(make_base):
    base = make_base(num_envs=2)
    env = make_env(
        base, {"action": JointVelocityTarget(base, limit=3.0), "power": JointPower(base)}
    )
    check_env_specs(env)
    assert not env.reset()["power"].any()
    assert "substeps" not in env.rollout(2).keys()
