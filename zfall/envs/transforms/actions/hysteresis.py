"""Commands that small changes do not move."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.actions.commands import read_commands, targets_before
from zfall.envs.transforms.base_env import needs_env, streams_of
from zfall.envs.transforms.drawn import declare_drawn, drawn_mirror, show_drawn
from zfall.envs.transforms.values import per_world, reset_rows, two_numbers
from zfall.values import Name, NotNegative, NotNegativeBounds


class Backlash(Transform):
    """Gives the gears play: a command that turns around moves nothing until the play is used up.

    The play operator on the command: ``y = clamp(y, x - width / 2, x + width / 2)`` at every
    physics step. It begins an episode in the middle of the play, where the joints are or
    ``targets_before`` says.

    Keys: reads ``control`` ``(N, S, J)`` [rad] if an earlier transform wrote it, else ``target``
    ``(N, J)``; writes ``control``, and with ``param`` ``("params", param)`` ``(N, 1)``, the play
    [rad].

    Args:
        env: the base env.
        width: of the play, from end to end [rad]; about 0.017 in small hobby servos. Of two, the
            smallest and the largest, it is drawn per episode, one for all joints of a world.
        param: name under which the play is shown; ``null``: it is not.

    Raises:
        ValueError: if ``width`` is negative, or the smaller one does not come first.

    Source: Visintin, "Differential Models of Hysteresis", Springer 1994, chapter III (play).
    """

    hardware = "commands"
    level: Tensor
    drawn: Tensor | None

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        width: NotNegative | NotNegativeBounds,
        param: Name | None = None,
    ):
        super().__init__(in_keys_inv=["control"], out_keys_inv=["control"])
        needs_env(self, env, "a memory of each world's commands")
        several = isinstance(width, Sequence)
        self.bounds = low, high = two_numbers("width", width if several else [width, width])
        if not low >= 0:
            raise ValueError(f"width must not be negative, got {width}.")
        if not low <= high:
            raise ValueError(f"width must have the smaller number first, got {width}.")
        self.width, self.substeps = high, env.substeps
        self.param, self.mirror_signs = param, drawn_mirror(param)
        self.register_buffer("drawn", torch.zeros(env.num_envs, 1) if several else None)
        self.register_buffer("level", env.stand_position.repeat(env.num_envs, 1))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        half = self._play() / 2
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
        if self.drawn is not None:
            low, high = self.bounds
            u = streams_of(self).uniform((1,), rows)
            self.drawn = torch.where(rows[:, None], low + (high - low) * u, self.drawn)
        return self._show(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._show(next_tensordict)

    def _play(self) -> float | Tensor:
        return per_world(self.width, 2) if self.drawn is None else self.drawn

    def _show(self, tensordict: TensorDictBase) -> TensorDictBase:
        play = torch.as_tensor(self._play()).expand(len(self.level), 1)
        return show_drawn(tensordict, self.param, play)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        return declare_drawn(observation_spec, self.param)


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

    hardware = "commands"
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
