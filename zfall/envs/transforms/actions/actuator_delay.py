"""Commands that arrive late."""

from typing import Annotated

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.actions.commands import read_commands, targets_before
from zfall.envs.transforms.base_env import needs_env, streams_of
from zfall.envs.transforms.drawn import declare_drawn, drawn_mirror, show_drawn
from zfall.envs.transforms.lags import Lags
from zfall.envs.transforms.values import reset_rows
from zfall.values import Name, NotNegative, NotNegativeBounds, one_of


class ActuatorDelay(Transform):
    """Lets the servos follow their commands a little late, each world by its own delay.

    A delay is drawn uniformly between its bounds and rounded to physics steps: the command meant
    for time t acts at t + delay. A delay drawn anew at every control step holds for all physics
    steps of that step; where it grows, the servos get some commands a second time, where it
    shrinks they miss some.

    Keys: reads ``control`` ``(N, S, J)`` [rad] if an earlier transform wrote it, else ``target``
    ``(N, J)``; writes ``control``, until the first command arrives the angles of the joints at the
    reset, or what ``targets_before`` says. With ``param`` also ``("params", param)`` ``(N, 1)``,
    the delay [s].

    Args:
        env: the base env.
        delay: shortest and longest delay [s].
        max_delay: length of the buffer [s]; what ``delay`` may be set to later.
        per: when a delay is drawn, every ``episode`` or every control ``step``.
        joints: ``shared``, one delay for all joints of a world, or ``own``, one for each.
        param: name under which the delay is shown; ``null``: it is not.

    Raises:
        ValueError: if the delays are not in order within [0, max_delay], an option is unknown, or
            delays of single joints are to be shown.
    """

    hardware = "commands"

    history: Tensor
    lag: Tensor
    slot: Tensor
    substep: Tensor
    first: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        delay: NotNegativeBounds,
        max_delay: NotNegative = 0.1,
        per: Annotated[str, one_of("episode", "step")] = "episode",
        joints: Annotated[str, one_of("shared", "own")] = "shared",
        param: Name | None = None,
    ):
        super().__init__(in_keys_inv=["control"], out_keys_inv=["control"])
        needs_env(self, env, "a memory of each world's commands")
        self.limits = {"delay": (0.0, max_delay)}
        self._lags = Lags(delay, max_delay=max_delay, per=per, physics_dt=env.physics_dt)
        if joints not in ("shared", "own"):
            raise ValueError(f"joints must be shared or own, got {joints!r}.")
        if param is not None and joints == "own":
            raise ValueError(f"param must be null where each joint has its delay, got {param}.")
        self.param, self.mirror_signs = param, drawn_mirror(param)
        self.delay, self.per, self.joints, self.substeps = delay, per, joints, env.substeps
        self.physics_dt = env.physics_dt
        num, length = env.num_envs, self._lags.ring(env.substeps, env.substeps)
        shape = (num,) if joints == "shared" else (num, len(env.stand_position))
        # A ring of the last commands at the rate of the physics, the place in it of the coming
        # control step's, the same in all worlds, and the delay in physics steps.
        self.register_buffer("history", env.stand_position.repeat(num, length, 1))
        self.register_buffer("slot", torch.zeros((), dtype=torch.long))
        self.register_buffer("lag", torch.zeros(shape, dtype=torch.long))
        self.register_buffer("substep", torch.arange(env.substeps))
        self.register_buffer("first", length * torch.arange(num)[:, None])  # row of each world

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.per == "step":
            self.lag = self._lags.draw(self.delay, self.lag.shape, streams_of(self))
        commands, slot = read_commands(self, tensordict, self.substeps), int(self.slot)
        length, end = self.history.shape[1], slot + self.substeps
        self.history[:, slot:end] = commands
        self.slot.fill_(end % length)
        if self.joints == "shared":  # whole rows of joints: several times as fast as a gather
            rows = self.first + (slot + self.substep - self.lag[:, None]) % length
            control = self.history.flatten(0, 1).index_select(0, rows.flatten())
            return tensordict.set("control", control.view_as(commands))
        index = (slot + self.substep[:, None] - self.lag[:, None]) % length
        return tensordict.set("control", self.history.gather(1, index))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return show_drawn(next_tensordict, self.param, self.physics_dt * self.lag)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        if self.per == "episode":
            lag = self._lags.draw(self.delay, self.lag.shape, streams_of(self), rows)
            self.lag = torch.where(rows.view(-1, *[1] * (lag.ndim - 1)), lag, self.lag)
        before = targets_before(tensordict, tensordict_reset["joint_position"])
        self.history[rows] = before[rows, None]
        return show_drawn(tensordict_reset, self.param, self.physics_dt * self.lag)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        return declare_drawn(observation_spec, self.param)
