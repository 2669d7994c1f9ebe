"""A servo that follows its command gradually."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.actions.commands import read_commands, targets_before
from zfall.envs.transforms.base_env import needs_env
from zfall.envs.transforms.values import POSITIVE, per_world, reset_rows
from zfall.values import NotNegative


class LowPass(Transform):
    """Smooths the commands by a first-order lag: a filter on the way, or a servo's own lag.

    ``y += (1 - exp(-dt / time_constant)) (x - y)`` at every physics step dt, the exact solution of
    ``time_constant dy/dt = x - y`` for a command x that is constant over the step; the servo
    gets the value at the end of the step. It begins an episode where the joints are or
    ``targets_before`` says.

    Keys: reads ``control`` ``(N, S, J)`` [rad] if an earlier transform wrote it, else ``target``
    ``(N, J)``; writes ``control``.

    Args:
        env: the base env.
        time_constant: of the lag [s].

    Raises:
        ValueError: if ``time_constant`` is not positive.
    """

    level: Tensor
    age: Tensor

    limits = {"time_constant": POSITIVE}

    def __init__(self, env: HumanoidEnv, *, time_constant: NotNegative):
        super().__init__(in_keys_inv=["control"], out_keys_inv=["control"])
        needs_env(self, env, "a memory of each world's commands")
        if not time_constant > 0:
            raise ValueError(f"time_constant must be positive, got {time_constant}.")
        self.time_constant, self.substeps = time_constant, env.substeps
        self.register_buffer("level", env.stand_position.repeat(env.num_envs, 1))
        # Time from command i to the value at the end of step s [s], row s and column i; the
        # column before the commands belongs to the level before the step.
        step = torch.arange(env.substeps)
        age = step[:, None] - torch.arange(-1, env.substeps)
        self.register_buffer("age", torch.where(age < 0, torch.inf, env.physics_dt * age))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        decay = torch.exp(-self.age / per_world(self.time_constant, 3))
        gain = 1.0 - decay[..., :1, :1]
        weight = torch.cat([decay[..., :1], gain * decay[..., 1:]], -1)
        commands = read_commands(self, tensordict, self.substeps)
        control = weight @ torch.cat([self.level[:, None], commands], 1)
        self.level = control[:, -1].clone()
        return tensordict.set("control", control)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        before = targets_before(tensordict, tensordict_reset["joint_position"])
        self.level = torch.where(rows[:, None], before, self.level)
        return tensordict_reset
