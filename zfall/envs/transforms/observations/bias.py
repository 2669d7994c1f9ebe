"""Errors that last: constant in an episode, or wandering."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env, streams_of
from zfall.envs.transforms.observations.measured import (
    declare_measured,
    key_shapes,
    measured_key,
    read_measured,
)
from zfall.envs.transforms.values import NOT_NEGATIVE, check_not_negative, per_world, reset_rows
from zfall.values import NotNegative


class ObservationBias(Transform):
    """Adds an error that is drawn at a reset and stays for the episode.

    ``measured += bias`` with ``bias = std * N(0, 1) + uniform * U(-1, 1)`` for every component
    and world.

    Keys: reads each key, measured so far or true, and writes ``("measured", key)``, of the same
    shape and unit.

    Args:
        env: the base env.
        std: standard deviation of each key's bias, in the key's own unit.
        uniform: largest bias of each key, in the key's own unit.

    Raises:
        ValueError: on a negative value, no key at all, or a key that the base env does not have.
    """

    hardware = "sensors"
    limits = {"std": NOT_NEGATIVE, "uniform": NOT_NEGATIVE}

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        std: Mapping[str, NotNegative] | None = None,
        uniform: Mapping[str, NotNegative] | None = None,
    ):
        self.std, self.uniform = dict(std or {}), dict(uniform or {})
        keys = list(dict.fromkeys((*self.std, *self.uniform)))
        super().__init__(in_keys=keys, out_keys=[measured_key(key) for key in keys])
        needs_env(self, env, "a memory of each world")
        if not keys:
            raise ValueError("std or uniform must name at least one key, got none.")
        check_not_negative("std", self.std)
        check_not_negative("uniform", self.uniform)
        shapes = key_shapes(env, "std", self.std) | key_shapes(env, "uniform", self.uniform)
        self.keys = keys
        for key in keys:
            self.register_buffer(f"bias_{key}", torch.zeros(shapes[key]))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self.keys:
            value = read_measured(next_tensordict, key)
            next_tensordict[measured_key(key)] = value + getattr(self, f"bias_{key}")
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        for key in self.keys:
            old: Tensor = getattr(self, f"bias_{key}")
            new = torch.zeros_like(old)
            if key in self.std:
                noise = streams_of(self).normal(old.shape[1:], rows)
                new += per_world(self.std[key], old.ndim) * noise
            if key in self.uniform:
                noise = 2.0 * streams_of(self).uniform(old.shape[1:], rows) - 1.0
                new += per_world(self.uniform[key], old.ndim) * noise
            mask = rows.view(-1, *[1] * (old.ndim - 1))
            setattr(self, f"bias_{key}", torch.where(mask, new, old))
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        declare_measured(observation_spec, "std", self.std)
        declare_measured(observation_spec, "uniform", self.uniform)
        return observation_spec


class ObservationRandomWalk(Transform):
    """Adds an error that wanders from zero at the reset: the drift of a gyro's bias.

    ``walk += rate * sqrt(control_dt) * N(0, 1)`` at every control step, ``measured += walk``; its
    standard deviation is ``rate * sqrt(t)`` after t seconds, at any control rate.

    Keys: reads each key, measured so far or true, and writes ``("measured", key)``, of the same
    shape and unit.

    Args:
        env: the base env.
        rate: of each key, in the key's own unit per square root of a second.

    Raises:
        ValueError: on a negative rate, or a key that the base env does not have.
    """

    hardware = "sensors"
    limits = {"rate": NOT_NEGATIVE}

    def __init__(self, env: HumanoidEnv, *, rate: Mapping[str, NotNegative]):
        super().__init__(in_keys=list(rate), out_keys=[measured_key(key) for key in rate])
        needs_env(self, env, "a memory of each world")
        check_not_negative("rate", rate)
        self.rate, self.control_dt = dict(rate), env.control_dt
        for key, shape in key_shapes(env, "rate", rate).items():
            self.register_buffer(f"walk_{key}", torch.zeros(shape))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key, rate in self.rate.items():
            walk: Tensor = getattr(self, f"walk_{key}")
            noise = streams_of(self).normal(walk.shape[1:])
            walk = walk + per_world(rate, walk.ndim) * self.control_dt**0.5 * noise
            setattr(self, f"walk_{key}", walk)
            next_tensordict[measured_key(key)] = read_measured(next_tensordict, key) + walk
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        for key in self.rate:
            walk: Tensor = getattr(self, f"walk_{key}")
            mask = rows.view(-1, *[1] * (walk.ndim - 1))
            walk = torch.where(mask, 0.0, walk)
            setattr(self, f"walk_{key}", walk)
            tensordict_reset[measured_key(key)] = read_measured(tensordict_reset, key) + walk
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        declare_measured(observation_spec, "rate", self.rate)
        return observation_spec
