"""What a training asks of the processes that share it; here of the one that trains alone.

``OneRank`` gives back what it is handed. ``zfall.training.several_ranks.SeveralRanks`` has the
same methods and reduces over processes. General code calls them and does not know which it has.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.modules.normalization import Moments, moments_of
from zfall.training.minibatches import drawn_samples, learned_steps

Policy = Callable[[TensorDictBase], TensorDictBase]
Figures = Mapping[str, tuple[float, float | None]]  # mean and its weight, or a sum and None


@dataclass(frozen=True)
class Piece:
    """Worlds of a group that one rank steps.

    Attributes:
        group: of the training's worlds.
        first: of them within the group.
        worlds: how many.
    """

    group: int
    first: int
    worlds: int


class Share(Protocol):
    """A rank's part of a minibatch.

    Attributes:
        rows: of the rank's own data, in the order of the minibatch ``(n,)``.
    """

    rows: Tensor

    def fitted(self, rows: int) -> "Share":
        """The same of a minibatch to which an augmentation has added rows."""

    def leading(self, share: float) -> "Share":
        """Of the first rows of the minibatch, a ``share`` of all."""

    def drawing(self) -> AbstractContextManager[Any]:
        """Within it random numbers are those of the whole minibatch."""

    def weighed(self, out: TensorDictBase, loss: Any, seen: TensorDictBase) -> TensorDictBase:
        """The losses ``out`` of this rank, weighed so that the sum over ranks is that of the whole.

        Args:
            out: what the loss gave.
            loss: which.
            seen: the part of the minibatch that it was given.
        """


class Ranks(Protocol):
    """The processes of one training.

    Attributes:
        rank, size: this one's number, and how many there are.
        leads: whether it writes the run folder and speaks.
    """

    rank: int
    size: int
    leads: bool

    def pieces(self, sizes: Sequence[int], alike: int) -> list[Piece]:
        """Which worlds of groups of these sizes are this rank's."""

    def drawing(
        self, piece: int, policy: Policy, carrier: TensorDictBase
    ) -> AbstractContextManager[Any]:
        """Within it a policy that acts in a piece draws what it would among all worlds."""

    def take_over(self, losses: Mapping[str, Any]) -> None:
        """Is told the losses of a training once."""

    def minibatches(self, rows: int, parts: int) -> Iterator[Share]:
        """Shares of as many minibatches, of all ranks' data; this rank has ``rows`` of it."""

    def standardize(
        self, minibatches: Sequence[tuple[TensorDictBase, Any]], loss: Any, first: int
    ) -> list[int]:
        """Makes the advantages of the minibatches of a pass what PPO's ``loss`` wants them to be.

        Args:
            minibatches: this rank's parts, and its shares.
            loss: of PPO.
            first: control step of a sequence from which on it learns.

        Returns:
            How many samples of each, over all ranks, the policy drew itself.
        """

    def add_up(self, parameters: Sequence[Tensor], out: TensorDictBase) -> dict[str, Tensor]:
        """Figures of a whole minibatch ``()``, and its gradient in place of the rank's."""

    def moments(self, rows: Tensor) -> Moments:
        """Number, mean and variance of rows ``(n, D)`` of all ranks."""

    def mean(self, values: Tensor) -> Tensor:
        """Mean over all ranks' values ``()``."""

    def standardized(self, values: Tensor) -> Tensor:
        """Values less their mean, in units of their standard deviation, both over all ranks."""

    def means(self, figures: Figures) -> dict[str, float]:
        """Figures of all ranks: means by their weights, and sums; without weight left out."""

    def sum(self, numbers: Tensor) -> Tensor:
        """Small tensors summed over all ranks, in their place."""

    def any(self, flag: bool) -> bool:
        """Whether it is so on any rank."""

    def gathered(self, value: Any) -> list[Any]:
        """What each rank has, by rank."""

    def wait(self) -> None:
        """Comes back when all ranks have come here, however long the leading one takes."""

    def check_same(self, parameters: Sequence[Tensor]) -> None:
        """Raises ``ValueError`` if weights or random numbers differ between ranks."""


class WholeMinibatch:
    """The share of a process that trains alone: all of it."""

    def __init__(self, rows: Tensor):
        self.rows = rows

    def fitted(self, rows: int) -> "WholeMinibatch":
        return self if rows == len(self.rows) else WholeMinibatch(torch.arange(rows))

    def leading(self, share: float) -> "WholeMinibatch":
        return WholeMinibatch(self.rows[: max(1, round(share * len(self.rows)))])

    def drawing(self) -> AbstractContextManager[Any]:
        return nullcontext()

    def weighed(self, out: TensorDictBase, loss: Any, seen: TensorDictBase) -> TensorDictBase:
        return out


class OneRank:
    """A process that trains alone."""

    rank, size, leads = 0, 1, True

    def pieces(self, sizes: Sequence[int], alike: int) -> list[Piece]:
        return [Piece(group, 0, worlds) for group, worlds in enumerate(sizes)]

    def drawing(
        self, piece: int, policy: Policy, carrier: TensorDictBase
    ) -> AbstractContextManager[Any]:
        return nullcontext()

    def take_over(self, losses: Mapping[str, Any]) -> None:
        pass

    def minibatches(self, rows: int, parts: int) -> Iterator[Share]:
        for chosen in torch.randperm(rows).tensor_split(parts):
            yield WholeMinibatch(chosen)

    def standardize(
        self, minibatches: Sequence[tuple[TensorDictBase, Any]], loss: Any, first: int
    ) -> list[int]:
        return [drawn_samples(learned_steps(part, first)) for part, _ in minibatches]

    def add_up(self, parameters: Sequence[Tensor], out: TensorDictBase) -> dict[str, Tensor]:
        return {key: value.detach().mean() for key, value in out.items()}

    def moments(self, rows: Tensor) -> Moments:
        return moments_of(rows)

    def mean(self, values: Tensor) -> Tensor:
        return values.mean()

    def standardized(self, values: Tensor) -> Tensor:
        return (values - values.mean()) / values.std().clamp_min(1e-6)

    def means(self, figures: Figures) -> dict[str, float]:
        return {key: value for key, (value, weight) in figures.items() if weight != 0}

    def sum(self, numbers: Tensor) -> Tensor:
        return numbers

    def any(self, flag: bool) -> bool:
        return flag

    def gathered(self, value: Any) -> list[Any]:
        return [value]

    def wait(self) -> None:
        pass

    def check_same(self, parameters: Sequence[Tensor]) -> None:
        pass


ALONE = OneRank()
