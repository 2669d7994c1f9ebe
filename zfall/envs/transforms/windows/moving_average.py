"""Quantities as they are on average over the recent past."""

import math
from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.values import reset_rows
from zfall.values import Positive


class MovingAverage(Transform):
    """Averages quantities over the recent past, with weights that fall off exponentially.

    ``y_t = a y_{t-1} + (1 - a) x_t`` with ``a = exp(-control_dt / seconds)``; after a reset y is x.
    It shows what lasts, such as the load of a servo, below the noise of exploration.

    Keys: reads the keys of ``keys`` ``(N, D)``, of the base env; writes their values ``(N, D)``.

    Args:
        env: the base env.
        keys: ``{read: written}``, as in ``{joint_torque: mean_joint_torque}``.
        seconds: time in which the weight falls by a factor of e [s].

    Raises:
        ValueError: if there is no key, one that the base env does not measure, a name that is
            taken, or a time that is not positive.
    """

    def __init__(self, env: HumanoidEnv, *, keys: Mapping[str, str], seconds: Positive):
        if not keys:
            raise ValueError("keys must name at least one quantity, got none.")
        if not 0 < seconds < math.inf:
            raise ValueError(f"seconds must be positive and finite, got {seconds}.")
        measured = env.observation_spec
        for key, name in keys.items():
            if key not in measured.keys() or not measured[key].dtype.is_floating_point:
                raise ValueError(f"keys must name numbers of the base env, got {key}.")
            if name in measured.keys() or list(keys.values()).count(name) > 1:
                raise ValueError(f"keys must be written to names of their own, {name} is taken.")
        super().__init__(in_keys=list(keys), out_keys=list(keys.values()))
        needs_env(self, env, "a memory of each world")
        self.mirror_like = {name: key for key, name in keys.items()}
        self.keeps = math.exp(-env.control_dt / seconds)
        for key, name in keys.items():
            self.register_buffer(name, torch.zeros(measured[key].shape))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, None)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._write(tensordict_reset, reset_rows(tensordict, self))

    def _write(self, tensordict: TensorDictBase, new: Tensor | None) -> TensorDictBase:
        for key, name in zip(self.in_keys, self.out_keys, strict=True):
            value, before = tensordict[key], getattr(self, name)
            if new is None:
                mean = torch.lerp(value, before, self.keeps)
            else:
                mean = torch.where(new.reshape(-1, *[1] * (value.ndim - 1)), value, before)
            setattr(self, name, mean)
            tensordict.set(name, mean)
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for name in self.out_keys:
            observation_spec[name] = Unbounded(getattr(self, name).shape)
        return observation_spec
