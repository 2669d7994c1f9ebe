"""Quantities in units of their ranges."""

from collections.abc import Mapping, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.on_robot import Known, OnRobot, lined_up
from zfall.envs.transforms.base_env import on_data
from zfall.envs.transforms.observations.measured import read_measured
from zfall.envs.transforms.observations.vector import vector_size
from zfall.values import Bounds, Keys, Name

Affine = tuple[float | Tensor, float | Tensor]  # factor, summand


class NormalizedVector(Transform):
    """Lines up several quantities in one vector, each scaled by its range.

    ``a + (b - a) (x - low) / (high - low)``, which takes [low, high] to [a, b]; nothing is cut
    off outside. Quantities without a range stay as they are.

    Keys: reads ``keys`` (flattened; bool becomes 0 or 1), as measured where they are, writes
    ``out_key`` ``(N, D)``.

    Args:
        env: the base env.
        keys: names of the quantities, in order.
        ranges: by name, ``[low, high]`` in the unit of the quantity, or ``joint_range``, the range
            of each joint.
        out_key: name of the vector, ``observation`` or ``observation_critic``.
        onto: the interval [a, b].

    Raises:
        ValueError: on a range of a quantity that is not in ``keys``, or that is none.
    """

    measured = True
    forward = on_data

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        keys: Keys,
        ranges: Mapping[str, Bounds | str],
        out_key: Name,
        onto: Bounds = (-1.0, 1.0),
    ):
        self.keys = [key if isinstance(key, str) else tuple(key) for key in keys]
        super().__init__(in_keys=self.keys, out_keys=[out_key])
        if len(onto) != 2 or onto[0] == onto[1]:
            raise ValueError(f"onto must be two different numbers, got {list(onto)}.")
        self.affine: dict[NestedKey, Affine] = {}
        for name, bounds in ranges.items():
            if name not in self.keys:
                raise ValueError(f"ranges must name quantities of keys, got {name}.")
            low: float | Tensor
            high: float | Tensor
            if bounds == "joint_range":
                low, high = env.joint_range.unbind(-1)
            elif isinstance(bounds, str) or len(bounds) != 2 or not bounds[0] < bounds[1]:
                raise ValueError(f"ranges.{name} must be [low, high] or joint_range, got {bounds}.")
            else:
                low, high = bounds
            factor = (onto[1] - onto[0]) / (high - low)
            self.affine[name] = factor, onto[0] - low * factor

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        values = []
        for key in self.keys:
            value = read_measured(next_tensordict, key).flatten(next_tensordict.ndim)
            values.append(_scaled(value, self.affine.get(key)))
        return next_tensordict.set(self.out_keys[0], torch.cat(values, -1))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def on_robot(self) -> OnRobot:
        """The same on a robot."""
        return _NormalizedOnRobot(self.keys, self.out_keys, self.affine)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        size = vector_size(observation_spec, self.keys)
        observation_spec[self.out_keys[0]] = Unbounded((*observation_spec.shape, size))
        return observation_spec


def _scaled(value: Tensor, affine: Affine | None) -> Tensor:
    return value if affine is None else value * affine[0] + affine[1]


class _NormalizedOnRobot(OnRobot):
    def __init__(
        self,
        reads: Sequence[NestedKey],
        writes: Sequence[NestedKey],
        affine: Mapping[NestedKey, Affine],
    ):
        super().__init__(reads, writes)
        self.affine = dict(affine)

    def observe(self, known: Known) -> None:
        values = zip(self.reads, lined_up(known, self.reads), strict=True)
        scaled = [_scaled(value, self.affine.get(key)) for key, value in values]
        known[self.writes[0]] = torch.cat(scaled, -1)
