"""The resolution of a sensor."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite
from torchrl.envs import Transform

from zfall.envs.transforms.base_env import on_data
from zfall.envs.transforms.observations.measured import (
    declare_measured,
    measured_key,
    read_measured,
)
from zfall.envs.transforms.values import POSITIVE, per_world
from zfall.values import Positive


class Quantization(Transform):
    """Rounds what the robot measures to the steps of its encoders and converters.

    ``measured = step * round(measured / step)``, an error of half a step at most.

    Keys: reads each key, measured so far or true, and writes ``("measured", key)``, of the same
    shape and unit.

    Args:
        step: of each key, in the key's own unit; an encoder of 12 bits has 2 pi / 4096.

    Raises:
        ValueError: on a step that is not positive, or a key that is not there.
    """

    hardware = "sensors"
    limits = {"step": POSITIVE}
    forward = on_data

    def __init__(self, *, step: Mapping[str, Positive]):
        super().__init__(in_keys=list(step), out_keys=[measured_key(key) for key in step])
        for key, value in step.items():
            if not value > 0:
                raise ValueError(f"step.{key} must be positive, got {value}.")
        self.step = dict(step)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self.step:
            value = read_measured(next_tensordict, key)
            step = per_world(self.step[key], value.ndim)
            next_tensordict[measured_key(key)] = step * torch.round(value / step)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        declare_measured(observation_spec, "step", self.step)
        return observation_spec
