"""Commands sent straight through a transform, without the physics."""

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv


@pytest.fixture
def send() -> Callable[[Transform, torch.Tensor], torch.Tensor]:
    """Gives commands ``(N, K, J)`` to a transform, S at a time; returns what the servos get."""

    def run(transform: Transform, commands: torch.Tensor) -> torch.Tensor:
        out = []
        for control in commands.split(transform.substeps, 1):
            td = TensorDict({"control": control.clone()}, [len(commands)])
            out.append(transform._inv_call(td)["control"])
        return torch.cat(out, 1)

    return run


@pytest.fixture
def at_rest() -> Callable[[HumanoidEnv], TensorDict]:
    """What a reset into the standing pose writes, as far as transforms of commands read it."""

    def write(base: HumanoidEnv) -> TensorDict:
        num = base.num_envs
        return TensorDict({"joint_position": base.stand_position.expand(num, -1)}, [num])

    return write
