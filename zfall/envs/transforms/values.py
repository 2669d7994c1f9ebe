"""What of a transform differs from world to world: its numbers, and when an episode begins."""

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform
from torchrl.envs.transforms.utils import _get_reset

from zfall.envs.transforms.base_env import base_env_of

# Bounds of a field that ``Curriculum`` moves, in a transform's ``limits``.
NOT_NEGATIVE, POSITIVE = (0.0, math.inf), (1e-6, math.inf)


def reset_rows(tensordict: TensorDictBase, transform: Transform | None = None) -> Tensor:
    """The worlds that a reset touches ``(N,)`` bool.

    Args:
        tensordict: first argument of ``_reset``.
        transform: whose memory is reset, if it has one; refused outside of its env.
    """
    if transform is not None:
        base_env_of(transform)
    return _get_reset("_reset", tensordict).reshape(tensordict.batch_size)


def refuse_start(transform: Transform, tensordict: TensorDictBase, key: str) -> None:
    """For a start that gives a part of the state: refuses one that others have given already.

    Args:
        transform: the start.
        tensordict: of the reset, that it writes into.
        key: ``("start", key)`` is what such a start has written and this one would not replace.

    Raises:
        ValueError: if the key is there.
    """
    if ("start", key) in tensordict.keys(True):
        raise ValueError(
            f"{type(transform).__name__} must act before the start that has written {key}, of "
            "which it would replace a part alone, got it after; a Compose runs starts from its "
            "last to its first, a table of make_env from its first to its last."
        )


def per_world(value: float | Tensor, dims: int) -> float | Tensor:
    """A number as it is; one per world ``(N,)`` with dimensions added behind, ``dims`` in all.

    The result works with values ``(N, ...)`` of ``dims`` dimensions.
    """
    if isinstance(value, Tensor) and value.ndim == 1:
        return value.reshape(-1, *[1] * (dims - 1))
    return value


def check_not_negative(name: str, values: Mapping[str, float]) -> None:
    """Raises ``ValueError`` on what is no finite number from 0 on, naming the key ``name.KEY``."""
    for key, value in values.items():
        if not isinstance(value, Real) or value == math.inf:
            raise ValueError(f"{name}.{key} must be a finite number, got {value}.")
        if not value >= 0:
            raise ValueError(f"{name}.{key} must not be negative, got {value}.")


def two_numbers(name: str, value: Any) -> tuple[float, float]:
    """The two numbers that ``value`` holds; raises ``ValueError`` on anything else."""
    numbers = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else []
    if len(numbers) != 2 or not all(isinstance(x, Real) and math.isfinite(x) for x in numbers):
        hint = f"; [{value}, {value}] for always the same" if isinstance(value, Real) else ""
        raise ValueError(f"{name} must be two finite numbers, got {value}{hint}.")
    return numbers[0], numbers[1]
