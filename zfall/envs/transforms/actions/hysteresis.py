"""Commands that small changes do not move."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.actions.commands import read_commands, targets_before
from zfall.envs.transforms.base_env import needs_env
from zfall.envs.transforms.values import per_world, reset_rows
from zfall.values import NotNegative


class Backlash(Transform):
    """Gives the gears play: a command that turns around moves nothing until the play is used up.

    The play operator on the command: ``y = clamp(y, x - width / 2, x + width / 2)`` at every
    physics step. It begins an episode in the middle of the play, where the joints are or
    ``targets_before`` says.

    Keys: reads ``control`` ``(N, S, J)`` [rad] if an earlier transform wrote it, else ``target``
    ``(N, J)``; writes ``control``.

    Args:
        env: the base env.
        width: of the play, from end to end [rad]; about 0.017 in small hobby servos.

    Raises:
        ValueError: if ``width`` is negative.

    Source: Visintin, "Differential Models of Hysteresis", Springer 1994, chapter III (play).
    """

    level: Tensor

    def __init__(self, env: HumanoidEnv, *, width: NotNegative):
        super().__init__(in_keys_inv=["control"], out_keys_inv=["control"])
        needs_env(self, env, "a memory of each world's commands")
        if not width >= 0:
            raise ValueError(f"width must not be negative, got {width}.")
        self.width, self.substeps = width, env.substeps
        self.register_buffer("level", env.stand_position.repeat(env.num_envs, 1))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        half = per_world(self.width, 2) / 2
        control = read_commands(self, tensordict, self.substeps).clone()
        level = self.level
        for step in range(self.substeps):
            command = control[:, step]
            level = torch.clamp(level, command - half, command + half)
            control[:, step] = level
        self.level = level
        return tensordict.set("control", control)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        before = targets_before(tensordict, tensordict_reset["joint_position"])
        self.level = torch.where(rows[:, None], before, self.level)
        return tensordict_reset


class Deadband(Transform):
    """Lets the servos ignore a command that differs too little from the one they follow.

    ``y = x where |x - y| >= width, else y`` at every physics step. It begins an episode where
    the joints are or ``targets_before`` says.

    Keys: reads ``control`` ``(N, S, J)`` [rad] if an earlier transform wrote it, else ``target``
    ``(N, J)``; writes ``control``.

    Args:
        env: the base env.
        width: smallest change that is followed [rad].

    Raises:
        ValueError: if ``width`` is negative.
    """

    level: Tensor

    def __init__(self, env: HumanoidEnv, *, width: NotNegative):
        super().__init__(in_keys_inv=["control"], out_keys_inv=["control"])
        needs_env(self, env, "a memory of each world's commands")
        if not width >= 0:
            raise ValueError(f"width must not be negative, got {width}.")
        self.width, self.substeps = width, env.substeps
        self.register_buffer("level", env.stand_position.repeat(env.num_envs, 1))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        width = per_world(self.width, 2)
        control = read_commands(self, tensordict, self.substeps).clone()
        level = self.level
        for step in range(self.substeps):
            command = control[:, step]
            level = torch.where((command - level).abs() >= width, command, level)
            control[:, step] = level
        self.level = level
        return tensordict.set("control", control)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        before = targets_before(tensordict, tensordict_reset["joint_position"])
        self.level = torch.where(rows[:, None], before, self.level)
        return tensordict_reset
