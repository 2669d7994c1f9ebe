"""Measurements that arrive late."""

from typing import Annotated

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import check_recorded, needs_env, streams_of
from zfall.envs.transforms.drawn import declare_drawn, drawn_mirror, show_drawn
from zfall.envs.transforms.lags import Lags
from zfall.envs.transforms.observations.measured import declare_measured, measured_key
from zfall.envs.transforms.values import reset_rows
from zfall.values import Name, Names, NotNegative, NotNegativeBounds, one_of


class ObservationDelay(Transform):
    """Shows a group of sensors as they were a little earlier, in each world by its own delay.

    A delay is drawn uniformly between its bounds and rounded to physics steps; what is measured
    at time t is the state of t - delay, also between control steps. Before the time of the reset
    everything was as it is then. A delay drawn anew at every control step may show a state from
    before the one seen last. ``base_acceleration`` is then that of one physics step, not the mean
    over a control step, with a delay of 0 too.

    Keys: reads ``("substeps", key)`` ``(N, S, ...)`` and writes ``("measured", key)``
    ``(N, ...)``. It must stand before all transforms that measure the same keys: noise, bias and
    the like act on what it delivers. With ``param`` also writes ``("params", param)`` ``(N, 1)``,
    the delay [s].

    Args:
        env: the base env, which is made to record ``keys`` at every physics step.
        delay: shortest and longest delay [s].
        keys: the quantities of the group, see ``HumanoidEnv.record_substeps``.
        max_delay: length of the buffer [s]; what ``delay`` may be set to later.
        per: when a delay is drawn, every ``episode`` or every control ``step``.
        param: name under which the delay is shown; ``null``: it is not.

    Raises:
        ValueError: if the delays are not in order within [0, max_delay], on an unknown option, on
            no key at all or one that is not known at every physics step; when the specs are
            built, if an earlier transform has measured one of the keys.
    """

    hardware = "sensors"

    history: Tensor
    slot: Tensor
    lag: Tensor
    row: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        delay: NotNegativeBounds,
        keys: Names,
        max_delay: NotNegative = 0.1,
        per: Annotated[str, one_of("episode", "step")] = "episode",
        param: Name | None = None,
    ):
        super().__init__(in_keys=list(keys), out_keys=[measured_key(key) for key in keys])
        needs_env(self, env, "physics steps that it records")
        self.limits = {"delay": (0.0, max_delay)}
        self._lags = Lags(delay, max_delay=max_delay, per=per, physics_dt=env.physics_dt)
        if not keys:
            raise ValueError("keys must name at least one quantity, got none.")
        env.record_substeps(keys)
        self.param, self.mirror_signs = param, drawn_mirror(param)
        self.physics_dt = env.physics_dt
        self.delay, self.keys, self.per, self.substeps = delay, list(keys), per, env.substeps
        self._sizes = [env.observation_spec[key].shape[-1] for key in keys]
        length = self._lags.ring(env.substeps, 1)
        # A ring of all keys side by side at the rate of the physics, the place in it of the coming
        # control step's, the same in all worlds, and the delay in physics steps.
        self.register_buffer("history", torch.zeros(env.num_envs, length, sum(self._sizes)))
        self.register_buffer("slot", torch.zeros((), dtype=torch.long))
        self.register_buffer("lag", torch.zeros(env.num_envs, dtype=torch.long))
        self.register_buffer("row", torch.arange(env.num_envs))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        if self.per == "step":
            self.lag = self._lags.draw(self.delay, self.lag.shape, streams_of(self))
        slot = int(self.slot)
        end = slot + self.substeps
        self.history[:, slot:end] = self._read(next_tensordict)
        self.slot.fill_(end % self.history.shape[1])
        return self._deliver(next_tensordict)

    def _read(self, tensordict: TensorDictBase) -> Tensor:
        return torch.cat([tensordict["substeps", key] for key in self.keys], -1)

    def _deliver(self, tensordict: TensorDictBase) -> TensorDictBase:
        late = self.history[self.row, (self.slot - 1 - self.lag) % self.history.shape[1]]
        for key, value in zip(self.keys, late.split(self._sizes, -1), strict=True):
            tensordict[measured_key(key)] = value.contiguous()
        return show_drawn(tensordict, self.param, self.physics_dt * self.lag)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        if self.per == "episode":
            lag = self._lags.draw(self.delay, self.lag.shape, streams_of(self), rows)
            self.lag = torch.where(rows, lag, self.lag)
        self.history[rows] = self._read(tensordict_reset)[rows, -1:]
        return self._deliver(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        check_recorded(self, observation_spec, self.keys)
        for key in self.keys:
            if measured_key(key) in observation_spec.keys(True):
                raise ValueError(
                    f"keys must not be measured before they are delayed, got {key}: put "
                    "ObservationDelay before the other transforms that measure it, and name each "
                    "key in one ObservationDelay only."
                )
        declare_measured(observation_spec, "keys", self.keys)
        return declare_drawn(observation_spec, self.param)
