"""The last observations in one vector, by TorchRL's own transform in a table."""

import pytest
import torch
from torchrl.envs import CatFrames
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import ActuatorDelay, JointPositionTarget
from zfall.envs.transforms.observations import ObservationNoise, ObservationVector


def table(base) -> dict:
    vector = ObservationVector(keys=["joint_position"], out_key="observation", measured=True)
    return {
        "action": JointPositionTarget(base, scale=0.6),
        "delay": ActuatorDelay(base, delay=(0.0, 0.02)),
        "noise": ObservationNoise(base, std={"joint_position": 0.01}),
        "observation": vector,
        "history": CatFrames(N=3, dim=-1, in_keys=["observation"], out_keys=["observation"]),
    }


def test_a_partial_reset_fills_the_stack_of_its_rows_alone(make_base):
    base = make_base(num_envs=3)
    env = make_env(base, table(base))
    check_env_specs(env)
    td, seen = env.reset(), []
    for step in range(4):
        seen.append(td["measured", "joint_position"].clone())
        td["action"] = torch.randn(3, 20)
        _, td = env.step_and_maybe_reset(td)
        if step == 2:
            td["_reset"] = torch.tensor([[False], [True], [False]])
            td = env.reset(td)
    seen.append(td["measured", "joint_position"].clone())
    stack = td["observation"].unflatten(-1, (3, 20))
    for row, times in ((0, (2, 3, 4)), (1, (3, 3, 4)), (2, (2, 3, 4))):
        for place, time in enumerate(times):
            assert torch.equal(stack[row, place], seen[time][row]), (row, place)


def test_sensing_after_the_stack_is_refused(make_base):
    base = make_base(num_envs=2)
    late = table(base)
    late["noise"] = late.pop("noise")
    with pytest.raises(ValueError, match=r"transforms.noise must come before observation"):
        make_env(base, late)
