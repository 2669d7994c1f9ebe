"""Where measured values lie, next to the true ones."""

from collections.abc import Iterable

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from zfall.envs.humanoid import HumanoidEnv


def measured_key(key: NestedKey) -> tuple[str, ...]:
    """Key under which the measured value of ``key`` lies."""
    return ("measured", key) if isinstance(key, str) else ("measured", *key)


def read_measured(tensordict: TensorDictBase, key: NestedKey) -> Tensor:
    """What an earlier sensing transform left of ``key``, else its true value; float32."""
    value = tensordict.get(measured_key(key), None)
    return (tensordict[key] if value is None else value).float()


def declare_measured(spec: Composite, name: str, keys: Iterable[str]) -> None:
    """Adds the measured values of ``keys`` to a spec.

    Args:
        spec: of the observations so far.
        name: of the parameter that gives the keys, for the error.
        keys: names of quantities.

    Raises:
        ValueError: on a key that is not there.
    """
    for key in keys:
        if key not in spec.keys(True):
            names = ", ".join(str(k) for k in spec.keys(True, True))
            raise ValueError(f"{name} must name quantities made before it ({names}), got {key}.")
        spec[measured_key(key)] = Unbounded(spec[key].shape, dtype=torch.float32)


def key_shapes(env: HumanoidEnv, name: str, keys: Iterable[str]) -> dict[str, torch.Size]:
    """Shapes ``(N, ...)`` of quantities of the base env, for what a transform keeps of them.

    Raises:
        ValueError: on a key that the base env does not have; ``name`` is that of the parameter.
    """
    there = env.observation_spec
    unknown = [key for key in keys if key not in there.keys()]
    if unknown:
        raise ValueError(
            f"{name} must name quantities of the base env ({', '.join(there.keys())}), "
            f"got {unknown[0]}."
        )
    return {key: there[key].shape for key in keys}


def check_not_measured(spec: Composite, name: str, key: NestedKey) -> None:
    """Refuses an estimate of what an earlier transform has measured already.

    Args:
        spec: of the observations so far.
        name: of the transform, for the error.
        key: that it writes.

    Raises:
        ValueError: if the key is there.
    """
    if key in spec.keys(True):
        raise ValueError(
            f"{name} must stand before other transforms that measure the same, but {key} is "
            "already there; noise on an estimate stands after it."
        )
