"""Several quantities in one vector."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.on_robot import Known, OnRobot, lined_up
from zfall.envs.transforms.base_env import on_data
from zfall.envs.transforms.observations.measured import read_measured
from zfall.values import Keys, Name


class ObservationVector(Transform):
    """Lines up several quantities in one vector.

    Keys: reads ``keys`` (flattened; bool becomes 0 or 1), writes ``out_key`` ``(N, D)``.

    Args:
        keys: names of the quantities, in order.
        out_key: name of the vector, ``observation`` or ``observation_critic``.
        measured: whether to take what sensing transforms left under ``("measured", key)``, where
            they did, in place of the true value.

    Raises:
        ValueError: if there is no key, or one that no transform before it writes.
    """

    forward = on_data

    def __init__(self, *, keys: Keys, out_key: Name, measured: bool):
        if not keys:
            raise ValueError(f"keys must name at least one quantity, got {list(keys)}.")
        self.keys = [key if isinstance(key, str) else tuple(key) for key in keys]
        super().__init__(in_keys=self.keys, out_keys=[out_key])
        self.measured = measured

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        dims = next_tensordict.ndim
        read = read_measured if self.measured else _read_true
        vector = torch.cat([read(next_tensordict, key).flatten(dims) for key in self.keys], -1)
        return next_tensordict.set(self.out_keys[0], vector)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def on_robot(self) -> OnRobot:
        """The same on a robot, which knows no other values than those that it measures."""
        return _VectorOnRobot(self.keys, self.out_keys)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        size = vector_size(observation_spec, self.keys)
        observation_spec[self.out_keys[0]] = Unbounded((*observation_spec.shape, size))
        return observation_spec


def vector_size(spec: Composite, keys: Sequence[NestedKey]) -> int:
    """Length of quantities of a spec, flattened and lined up.

    Raises:
        ValueError: on a key that is not there.
    """
    missing = [str(key) for key in keys if key not in spec.keys(True)]
    if missing:
        names = ", ".join(str(key) for key in spec.keys(True, True))
        raise ValueError(f"keys must name quantities made before them ({names}), got {missing[0]}.")
    return sum(spec[key].shape[len(spec.shape) :].numel() for key in keys)


def _read_true(tensordict: TensorDictBase, key: NestedKey) -> Tensor:
    return tensordict[key].float()


def vector_spans(spec: Composite | TensorDictBase, keys: Sequence[NestedKey]) -> dict[str, slice]:
    """Where each quantity lies in their vector; a nested key as ``outer/inner``."""
    spans, begin = {}, 0
    for key in keys:
        end = begin + spec[key].shape[len(spec.shape) :].numel()
        spans[key if isinstance(key, str) else "/".join(key)] = slice(begin, end)
        begin = end
    return spans


class _VectorOnRobot(OnRobot):
    def observe(self, known: Known) -> None:
        known[self.writes[0]] = torch.cat(lined_up(known, self.reads), -1)
