"""What of a task runs on the robot's computer: the part of a transform that is software.

A transform that is software has a method ``on_robot`` that gives one ``OnRobot``. What only
simulates the world declares ``hardware``, see ``zfall.envs.worlds``, and stays behind.
"""

from collections.abc import Callable, Mapping, Sequence

import torch
from tensordict import NestedKey
from torch import Tensor, nn

Known = dict[NestedKey, Tensor]


class OnRobot(nn.Module):
    """A part of a control step on plain tensors of one robot ``(1, ...)``.

    Both methods read and write ``known``, by key. There ``"begin"`` ``(1, 1)`` bool says that the
    robot has just been switched on, ``("state", NAME)`` is what the part has kept, and
    ``("next", NAME)`` is what it shall keep.

    Args:
        reads: quantities that ``observe`` reads.
        writes: quantities that it writes.
        states: what it keeps from step to step, by name, as it begins ``(1, ...)``.
    """

    def __init__(
        self,
        reads: Sequence[NestedKey],
        writes: Sequence[NestedKey],
        states: Mapping[str, Tensor] | None = None,
    ):
        super().__init__()
        self.reads, self.writes, self.states = [*reads], [*writes], dict(states or {})

    def observe(self, known: Known) -> None:
        """On the way to the observation."""

    def act(self, known: Known) -> None:
        """After the policy, on the way to ``"command"`` ``(1, K, J)`` [rad], one per tick."""


class Derived(OnRobot):
    """Quantities that follow from others of the same step.

    Args:
        reads: quantities.
        functions: by name, of the quantities read, in their order.
    """

    def __init__(self, reads: Sequence[NestedKey], functions: Mapping[str, Callable[..., Tensor]]):
        super().__init__(reads, list(functions))
        self.functions = dict(functions)

    def observe(self, known: Known) -> None:
        values = [seen(known, key) for key in self.reads]
        for name, function in self.functions.items():
            known["measured", name] = function(*values)


def seen(known: Known, key: NestedKey) -> Tensor:
    """A quantity as it was measured or estimated, float32."""
    measured = ("measured", key) if isinstance(key, str) else ("measured", *key)
    return known[measured if measured in known else key].float()


def lined_up(known: Known, keys: Sequence[NestedKey]) -> list[Tensor]:
    """Quantities as they were measured, each flattened ``(1, size)``."""
    return [seen(known, key).flatten(1) for key in keys]


def at_begin(known: Known, start: Tensor, state: Tensor) -> Tensor:
    """``start`` in the first step, else ``state``, both ``(1, ...)``."""
    begin = known["begin"].reshape(-1, *[1] * (state.ndim - 1))
    return torch.where(begin, start, state)
