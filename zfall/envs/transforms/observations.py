"""What the policy and the critic get to see."""

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv


def _measured(key: NestedKey) -> tuple[str, ...]:
    return ("measured", key) if isinstance(key, str) else ("measured", *key)


class ObservationNoise(Transform):
    """Adds white Gaussian noise to what the robot measures, and to nothing else.

    Keys: reads each key (what is under ``("measured", key)`` if an earlier transform put
    something there) and writes ``("measured", key)``, of the same shape and unit. The true
    value stays where it is, for rewards and the critic.

    Args:
        env: the base env.
        std: standard deviation of each key, in the key's own unit.

    Raises:
        ValueError: on a negative standard deviation.
    """

    def __init__(self, env: HumanoidEnv, *, std: dict[str, float]):
        super().__init__(in_keys=list(std), out_keys=[_measured(key) for key in std])
        for key, value in std.items():
            if value < 0:
                raise ValueError(f"std.{key} must not be negative, got {value}.")
        self.std, self.rng = std, env.rng

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key, std in self.std.items():
            true = next_tensordict[key]
            value = next_tensordict.get(_measured(key), true)
            noise = torch.randn(true.shape, generator=self.rng)
            next_tensordict[_measured(key)] = value + std * noise
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for key in self.std:
            if key not in observation_spec.keys(True):
                raise ValueError(f"std.{key} must name a key of the env, there is none.")
            observation_spec[_measured(key)] = observation_spec[key].clone()
        return observation_spec


class ObservationVector(Transform):
    """Lines up several quantities in one vector.

    Keys: reads ``keys`` (flattened; bool becomes 0 or 1), writes ``out_key`` ``(N, D)``.

    Args:
        keys: names of the quantities, in order.
        out_key: name of the vector, ``observation`` or ``observation_critic``.
        measured: whether to take what sensing transforms left under ``("measured", key)``, where
            they did, in place of the true value.
    """

    def __init__(self, *, keys: list[str], out_key: str, measured: bool):
        self.keys = [key if isinstance(key, str) else tuple(key) for key in keys]
        super().__init__(in_keys=self.keys, out_keys=[out_key])
        self.measured = measured

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        values = [self._read(next_tensordict, key) for key in self.keys]
        vector = torch.cat([value.flatten(1).float() for value in values], -1)
        return next_tensordict.set(self.out_keys[0], vector)

    def _read(self, source: TensorDictBase, key: NestedKey) -> torch.Tensor:
        value = source.get(_measured(key), None) if self.measured else None
        return source[key] if value is None else value

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        there = observation_spec.keys(True)
        missing = [str(key) for key in self.keys if key not in there]
        if missing:
            names = ", ".join(str(key) for key in observation_spec.keys(True, True))
            raise ValueError(
                f"keys must name quantities made before them ({names}), got {missing[0]}."
            )
        size = sum(observation_spec[key].shape[1:].numel() for key in self.keys)
        observation_spec[self.out_keys[0]] = Unbounded((*observation_spec.shape, size))
        return observation_spec
