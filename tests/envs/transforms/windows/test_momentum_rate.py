"""Rates of momentum: the forces from outside."""

import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.windows import MomentumRate

WEIGHT = 3.3494 * 9.81


def build(make_base, **values):
    base = make_base(num_envs=2, **values)
    action = JointPositionTarget(base, scale=1.0)
    return make_env(base, {"action": action, "momentum": MomentumRate(base)})


def test_rate_in_free_fall_is_the_weight_from_the_first_step_on(make_base):
    """However it moves its joints, and again after a partial reset; the physics loses some of it."""
    env = build(make_base, physics_dt=0.001)
    check_env_specs(env)
    td = env.reset()
    for step in range(8):
        if step in (0, 4):
            rows = torch.tensor([[True], [step == 0]])
            td = env.reset(td.set("_reset", rows)).exclude("_reset")
            assert not td["momentum_rate"][rows[:, 0]].any()
            env.base_env.simulation.qpos[:, 2] = 5.0
        td["action"] = 0.3 * torch.randn(2, 20)
        td = env.step(td)["next"]
        expected = torch.tensor([0.0, 0.0, -WEIGHT]).expand(2, 3)
        assert_close(td["momentum_rate"], expected, atol=0.2, rtol=0)
        assert_close(td["angular_momentum_rate"], torch.zeros(2, 3), atol=0.02, rtol=0)


def test_first_rate_with_one_physics_step_is_no_division_by_zero(make_base):
    env = build(make_base, control_dt=0.004)
    td = env.reset()
    td["action"] = torch.zeros(2, 20)
    td = env.step(td)["next"]
    assert_close(td["momentum_rate"], torch.zeros(2, 3))
