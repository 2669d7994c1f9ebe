"""A rank's part of a minibatch: its rows, their random numbers, and what its losses weigh."""

from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.modules.normalization import Moments
from zfall.training.draws import Draw, DrawnTogether

if TYPE_CHECKING:
    from zfall.training.several_ranks import SeveralRanks


class PartOfMinibatch:
    """A rank's share of a minibatch; without a row it takes one along, which counts nothing.

    Args:
        ranks: all of them.
        rows: of the rank's data ``(n,)``.
        places: where in the minibatch they are ``(n,)``, in this order.
        total: rows of the minibatch.
        alongs: rows that are taken along if there is none.
    """

    def __init__(
        self, ranks: "SeveralRanks", rows: Tensor, places: Tensor, total: int, alongs: int = 1
    ):
        self.real = len(rows) > 0
        self.rows = rows if self.real else rows.new_zeros(alongs)
        self.places = places if self.real else places.new_zeros(alongs)
        self.total_rows, self._ranks = total, ranks
        self._totals: dict[int, Tensor] = {}  # what a loss counts, over all ranks

    def fitted(self, rows: int) -> "PartOfMinibatch":
        times, rest = divmod(rows, len(self.rows))
        if rest:
            raise ValueError(
                f"augmentation must make so many rows of each, got {rows} of {len(self.rows)}."
            )
        if times == 1:
            return self
        own = self.rows if self.real else self.rows[:0]
        places = self.places if self.real else self.places[:0]
        shifted = [places + self.total_rows * number for number in range(times)]
        parts = own.repeat(times), torch.cat(shifted), self.total_rows * times
        return PartOfMinibatch(self._ranks, *parts, alongs=times)

    def leading(self, share: float) -> "PartOfMinibatch":
        total = max(1, round(share * self.total_rows))
        own = int((self.places < total).sum()) if self.real else 0
        return PartOfMinibatch(self._ranks, self.rows[:own], self.places[:own], total)

    def drawing(self) -> AbstractContextManager[Any]:
        def supply(draw: Draw) -> Tensor:
            return draw.of(self.total_rows).index_select(draw.axis, self.places.to(draw.device))

        return DrawnTogether(len(self.rows), supply)

    def told(self, loss: Any, totals: Tensor) -> None:
        """Takes in what a loss counts over all ranks, in the order of its names ``(K,)``."""
        self._totals[id(loss)] = totals

    def counted(self, loss: Any, seen: TensorDictBase) -> Tensor:
        """What the loss counts in this part, in the order of its names ``(K,)``."""
        counts = loss.counts(seen).values() if hasattr(loss, "counts") else ()
        own = [number.double().cpu() for number in counts]
        return torch.stack(own) * self.real if own else torch.zeros(0, dtype=torch.float64)

    def weighed(self, out: TensorDictBase, loss: Any, seen: TensorDictBase) -> TensorDictBase:
        """Means by the share of samples that they are of.

        A loss whose ``counts(batch)`` names outputs that are means over fewer samples than it has
        seen, and how many, has these weighed so.
        """
        weight = self.real * len(self.rows) / self.total_rows
        own = self.counted(loss, seen)
        weights: dict[str, float] = {}
        if len(own):
            known = self._totals.get(id(loss))
            everyone = self._ranks.sum(own.clone()) if known is None else known
            shares = (own / everyone.clamp_min(1.0)).tolist()
            weights = dict(zip(loss.counts(seen), shares, strict=True))
        extremes = self._ranks.largest
        summed = self._ranks.summed
        for key, value in out.items():
            factor = float(self.real) if key in summed else weights.get(key, weight)
            if key not in extremes:
                out[key] = value * factor
            elif not self.real:
                out[key] = torch.full_like(value, -torch.inf)
        return out


def standardized_by(values: Tensor, moments: Moments) -> Tensor:
    """Values less a mean, in units of a standard deviation, those of the moments ``(1,)``."""
    count, mean, variance = moments
    std = (variance * count / max(1, count - 1)).sqrt()
    return (values - mean.to(values)) / std.to(values).clamp_min(1e-6)
