"""Noise that is new at every step."""

from collections.abc import Mapping

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import needs_env, normal_for, on_data, uniform_for
from zfall.envs.transforms.observations.measured import (
    declare_measured,
    measured_key,
    read_measured,
)
from zfall.envs.transforms.values import (
    NOT_NEGATIVE,
    check_not_negative,
    per_world,
    reset_rows,
)
from zfall.values import NotNegative


class ObservationNoise(Transform):
    """Adds white noise to what the robot measures, and to nothing else.

    ``measured += std * N(0, 1)`` and ``measured += uniform * U(-1, 1)``, drawn anew for every
    component, world and control step; a key may have both. Directions and quaternions are not
    normalised afterwards.

    Keys: reads each key, measured so far or true, and writes ``("measured", key)``, of the same
    shape and unit. The true value stays where it is, for rewards and the critic.

    Args:
        env: the base env, whose streams give the random numbers; ``None``, as a replay buffer
            needs it, for torch's global generator.
        std: standard deviation of each key, in the key's own unit.
        uniform: largest deviation of each key, in the key's own unit.

    Raises:
        ValueError: on a negative value, no key at all, or a key that is not there.
    """

    hardware = "sensors"
    limits = {"std": NOT_NEGATIVE, "uniform": NOT_NEGATIVE}
    forward = on_data

    def __init__(
        self,
        env: HumanoidEnv | None = None,
        *,
        std: Mapping[str, NotNegative] | None = None,
        uniform: Mapping[str, NotNegative] | None = None,
    ):
        self.std, self.uniform = dict(std or {}), dict(uniform or {})
        keys = list(dict.fromkeys((*self.std, *self.uniform)))
        super().__init__(in_keys=keys, out_keys=[measured_key(key) for key in keys])
        if not keys:
            raise ValueError("std or uniform must name at least one key, got none.")
        check_not_negative("std", self.std)
        check_not_negative("uniform", self.uniform)
        if env is not None:
            needs_env(self, env, "its random numbers")

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._add(next_tensordict)

    def _add(self, next_tensordict: TensorDictBase, rows: Tensor | None = None) -> TensorDictBase:
        for key, std in self.std.items():
            value = read_measured(next_tensordict, key)
            noise = normal_for(self, value, rows)
            next_tensordict[measured_key(key)] = value + per_world(std, value.ndim) * noise
        for key, width in self.uniform.items():
            value = read_measured(next_tensordict, key)
            noise = 2.0 * uniform_for(self, value, rows) - 1.0
            next_tensordict[measured_key(key)] = value + per_world(width, value.ndim) * noise
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._add(tensordict_reset, reset_rows(tensordict))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        declare_measured(observation_spec, "std", self.std)
        declare_measured(observation_spec, "uniform", self.uniform)
        return observation_spec
