"""Measurements that do not arrive."""

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
from zfall.envs.transforms.values import reset_rows
from zfall.values import Fraction, Names


class ObservationDropout(Transform):
    """Loses the message of a group of sensors now and then: the last one delivered stays.

    At every control step, independently in each world with a given probability, all of ``keys``
    keep what they were when they last arrived. The measurement after a reset always arrives.

    Keys: reads each key, measured so far or true, and writes ``("measured", key)``, of the same
    shape and unit.

    Args:
        env: the base env.
        probability: that the group's message is lost in a step.
        keys: the quantities of the group.

    Raises:
        ValueError: if ``probability`` is not in [0, 1), on no key at all, or one that the base
            env does not have.
    """

    hardware = "sensors"

    def __init__(self, env: HumanoidEnv, *, probability: Fraction, keys: Names):
        super().__init__(in_keys=list(keys), out_keys=[measured_key(key) for key in keys])
        needs_env(self, env, "a memory of each world")
        if not 0 <= probability < 1:
            raise ValueError(f"probability must lie in [0, 1), got {probability}.")
        if not keys:
            raise ValueError("keys must name at least one quantity, got none.")
        self.probability, self.keys = probability, list(keys)
        for key, shape in key_shapes(env, "keys", keys).items():
            self.register_buffer(f"held_{key}", torch.zeros(shape))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        arrives = streams_of(self).uniform() >= self.probability
        return self._deliver(next_tensordict, arrives)

    def _deliver(self, tensordict: TensorDictBase, arrives: Tensor) -> TensorDictBase:
        for key in self.keys:
            value, held = read_measured(tensordict, key), getattr(self, f"held_{key}")
            held = torch.where(arrives.view(-1, *[1] * (value.ndim - 1)), value, held)
            setattr(self, f"held_{key}", held)
            tensordict[measured_key(key)] = held.clone()
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._deliver(tensordict_reset, reset_rows(tensordict, self))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        declare_measured(observation_spec, "keys", self.keys)
        return observation_spec
