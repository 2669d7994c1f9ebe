"""The size of the torques in the physics steps."""

import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.windows import JointEffort


def build(base):
    return make_env(base, {"action": JointPositionTarget(base, scale=1.0), "e": JointEffort(base)})


def test_effort_is_the_mean_of_what_an_env_of_single_physics_steps_reports(make_base):
    """Its torques are those of one physics step; averaged with their signs they nearly cancel."""
    base, fine = make_base(num_envs=2), HumanoidEnv(num_envs=2, control_dt=0.004)
    env = build(base)
    check_env_specs(env)
    td, slow = env.reset(), fine.reset()
    for _ in range(5):
        td["action"] = 0.5 * torch.randn(2, 20)
        td = env.step(td)["next"]
        torques = []
        for _ in range(10):
            slow["target"] = td["target"]
            slow = fine.step(slow)["next"]
            torques.append(slow["joint_torque"])
        torque = torch.stack(torques)
        assert_close(td["joint_effort"][:, 0], torque.abs().mean((0, 2)), rtol=1e-4, atol=1e-6)
        assert (torque.mean((0, 2)).abs() < 0.5 * td["joint_effort"][:, 0]).all()


def test_partial_reset_leaves_the_other_rows_alone(make_base):
    env = build(make_base(num_envs=2))
    td = env.reset()
    start = td["joint_effort"].clone()
    td["action"] = torch.randn(2, 20)
    td = env.step(td)["next"]
    moved = td["joint_effort"].clone()
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    assert_close(td["joint_effort"], torch.stack([start[0], moved[1]]))
