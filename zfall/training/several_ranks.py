"""One training in several processes: each steps its worlds, and all learn the same from them.

Every rank has a copy of the networks and takes its part of every minibatch. Gradients, statistics
and figures are summed over ranks, so that all take the same step. The order of samples, and what
is drawn for them, are those of one process with all the worlds: each rank draws them for all.

A pass over the data waits once for the network: moments of advantages, and what PPO's loss counts,
of all minibatches. Each minibatch waits once, for the gradient and figures, side by side. An
auxiliary loss that leaves samples out takes one more wait in each.
"""

import time
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import Any

import torch
import torch.distributed as dist
from tensordict import TensorDictBase
from torch import Tensor

from zfall.modules.normalization import Moments, merged_moments, moments_of
from zfall.training.draws import Draw, DrawnTogether
from zfall.training.launch import RankLost
from zfall.training.minibatches import drawn_samples, learned_steps
from zfall.training.ranks import Figures, Piece, Policy
from zfall.training.shares import PartOfMinibatch, standardized_by

_POLL = 0.05  # between two looks whether the leading rank has come [s]


class SeveralRanks:
    """One of the processes of a training, see ``zfall.training.ranks.Ranks``.

    Args:
        store: that all of them reach.
        timeout: for which one waits for another that is at work [s].
    """

    def __init__(self, store: dist.Store, timeout: float):
        self.rank, self.size = dist.get_rank(), dist.get_world_size()
        self.leads = self.rank == 0
        self.store, self.timeout = store, timeout
        self._sizes: list[int] = []
        self._pieces: list[Piece] = []
        self._pattern: list[Draw] | None = None  # what the policy draws in a step
        self._drawn: list[deque[list[Tensor]]] = []  # for each piece, steps to come
        self.summed: dict[str, Callable[[Tensor], Tensor]] = {}
        self.largest: set[str] = set()
        self._normalizes = False
        self._waits = 0

    def pieces(self, sizes: Sequence[int], alike: int) -> list[Piece]:
        """An equal part of all worlds, in their order, cut where a group ends.

        Raises:
            ValueError: if they cannot be divided so.
        """
        each, rest = divmod(sum(sizes), self.size)
        if rest or each % alike:
            parts = f"launch.ranks, {self.size}" + (f", times alike, {alike}" if alike > 1 else "")
            raise ValueError(f"num_envs must be a multiple of {parts}, got {sum(sizes)}.")
        mine, begins, pieces = range(self.rank * each, (self.rank + 1) * each), 0, []
        for group, size in enumerate(sizes):
            first, end = max(mine.start, begins), min(mine.stop, begins + size)
            if first < end:
                pieces.append(Piece(group, first - begins, end - first))
            begins += size
        self._sizes, self._pieces = list(sizes), pieces
        self._pattern, self._drawn = None, [deque() for _ in pieces]
        return pieces

    def drawing(
        self, piece: int, policy: Policy, carrier: TensorDictBase
    ) -> AbstractContextManager[Any]:
        rows = self._pieces[piece].worlds
        if self._pattern is None:
            self._pattern = []
            with torch.random.fork_rng(), DrawnTogether(rows, partial(self._noted, rows)):
                policy(carrier.copy())
        if not self._drawn[piece]:  # the groups act by turns, each once in a step
            for group, size in enumerate(self._sizes):
                numbers = [draw.of(size) for draw in self._pattern]
                for own, queue in zip(self._pieces, self._drawn, strict=True):
                    if own.group == group:
                        queue.append([
                            one.narrow(draw.axis, own.first, own.worlds).clone()
                            for one, draw in zip(numbers, self._pattern, strict=True)
                        ])  # fmt: skip
        coming = list(zip(self._drawn[piece].popleft(), self._pattern, strict=True))[::-1]
        return _all_of(coming, DrawnTogether(rows, partial(_supplied, coming)))

    def _noted(self, rows: int, draw: Draw) -> Tensor:
        assert self._pattern is not None
        self._pattern.append(draw)
        return draw.of(rows)

    def take_over(self, losses: Mapping[str, Any]) -> None:
        """Takes over what losses would compute from a minibatch, of which they see a part.

        A loss may have ``summed``: figures that are no means, by name what they are made of sums.
        With ``gives_sums`` it writes these in their place. ``largest`` names its maxima.
        """
        self.summed, self.largest, self._normalizes = {}, set(), False
        for loss in losses.values():
            self.summed |= getattr(loss, "summed", {})
            self.largest |= {*getattr(loss, "largest", ())}
            if hasattr(loss, "summed"):
                loss.gives_sums = True
            if getattr(loss, "normalize_advantage", False):
                loss.normalize_advantage, self._normalizes = False, True

    def minibatches(self, rows: int, parts: int) -> Iterator[PartOfMinibatch]:
        first, total = self.rank * rows, self.size * rows
        for chosen in torch.randperm(total).tensor_split(parts):
            places = ((chosen >= first) & (chosen < first + rows)).nonzero().squeeze(1)
            yield PartOfMinibatch(self, chosen[places] - first, places, len(chosen))

    def standardize(
        self, minibatches: Sequence[tuple[TensorDictBase, PartOfMinibatch]], loss: Any, first: int
    ) -> list[int]:
        own = []
        for part, share in minibatches:
            seen = learned_steps(part, first)
            count, mean, variance = moments_of(seen["advantage"].reshape(-1, 1).double())
            numbers = mean.new_tensor([count * share.real, drawn_samples(seen) * share.real])
            parts = numbers, mean, variance, share.counted(loss, seen)
            own.append(torch.cat([each.cpu() for each in parts]))
        everyone = self._gathered_rows(torch.stack(own)).transpose(0, 1)
        for (part, share), rows in zip(minibatches, everyone, strict=True):
            share.told(loss, rows[:, 4:].sum(0))
            if self._normalizes:
                moments = merged_moments((int(row[0]), row[2:3], row[3:4]) for row in rows)
                part["advantage"] = standardized_by(part["advantage"], moments)
        return [int(rows[:, 1].sum()) for rows in everyone]

    def add_up(self, parameters: Sequence[Tensor], out: TensorDictBase) -> dict[str, Tensor]:
        gradients = [each.grad for each in parameters if each.grad is not None]
        flat = torch.cat([gradient.reshape(-1) for gradient in gradients])
        with self._together():
            sum_of_all = dist.all_reduce(flat, async_op=True)
            shapes = {key: value.shape for key, value in out.items()}
            parts = [value.detach().reshape(-1).double().cpu() for value in out.values()]
            for key, at in zip(shapes, range(len(parts)), strict=True):
                if key in self.largest:  # every rank puts its own at a place of its own
                    slots = parts[at].new_zeros(self.size)
                    slots[self.rank] = parts[at].max()
                    parts[at] = slots
            figures = torch.cat(parts)
            dist.all_reduce(figures)
            sum_of_all.wait()
        pieces = flat.split([gradient.numel() for gradient in gradients])
        for gradient, piece in zip(gradients, pieces, strict=True):
            gradient.copy_(piece.view_as(gradient))
        found = {}
        for (key, shape), whole in zip(
            shapes.items(), figures.split([len(part) for part in parts]), strict=True
        ):
            if key in self.largest:
                found[key] = whole.max().float()
            else:
                value = self.summed.get(key, torch.Tensor.float)(whole.reshape(shape))
                found[key] = value.mean().float()
        return found

    def moments(self, rows: Tensor) -> Moments:
        count, mean, variance = moments_of(rows)
        own = torch.cat([mean.new_tensor([count], dtype=torch.float64), mean, variance])
        everyone = self._gathered_rows(own.cpu())
        parts = ((int(row[0]), *row[1:].chunk(2)) for row in everyone)
        total, mean_of_all, variance_of_all = merged_moments(parts)
        return total, mean_of_all.to(mean.device), variance_of_all.to(mean.device)

    def mean(self, values: Tensor) -> Tensor:
        _, mean, _ = self.moments(values.reshape(-1, 1).double())
        return mean.squeeze().to(values.dtype)

    def standardized(self, values: Tensor) -> Tensor:
        return standardized_by(values, self.moments(values.reshape(-1, 1).double()))

    def means(self, figures: Figures) -> dict[str, float]:
        everyone: list[Figures] = self.gathered(dict(figures))
        names = list(dict.fromkeys(name for one in everyone for name in one))
        found = {}
        for name in names:
            there = [one[name] for one in everyone if name in one]
            if there[0][1] is None:
                found[name] = sum(value for value, _ in there)
            elif (total := sum(weight or 0 for _, weight in there)) > 0:
                found[name] = sum(value * weight for value, weight in there if weight) / total
        return found

    def any(self, flag: bool) -> bool:
        return bool(self.sum(torch.tensor([int(flag)])).item())

    def sum(self, numbers: Tensor) -> Tensor:
        """The sum of small tensors over all ranks, in their place."""
        with self._together():
            dist.all_reduce(numbers)
        return numbers

    def gathered(self, value: Any) -> list[Any]:
        everyone: list[Any] = [None] * self.size
        with self._together():
            dist.all_gather_object(everyone, value)
        return everyone

    def _gathered_rows(self, row: Tensor) -> Tensor:
        out = row.new_zeros(self.size, *row.shape)  # each its own row: their sum is all of them
        out[self.rank] = row
        return self.sum(out)

    def wait(self) -> None:
        self._waits += 1
        key = f"waited/{self._waits}"
        with self._together():
            if self.leads:
                self.store.set(key, "here")
            while not self.store.check([key]):
                time.sleep(_POLL)
        self.any(False)

    def check_same(self, parameters: Sequence[Tensor]) -> None:
        weights = sum(int(each.detach().view(torch.int32).sum()) for each in parameters)
        numbers = zlib.crc32(torch.get_rng_state().numpy().tobytes())
        own = torch.tensor([weights, numbers], dtype=torch.int64)
        everyone = self._gathered_rows(own)
        for what, column in zip(("weights", "random numbers"), everyone.T, strict=True):
            if (column != column[0]).any():
                other = int((column != column[0]).nonzero()[0])
                raise ValueError(
                    f"launch.ranks must be 1 here: {what} of rank {other} are no longer those of "
                    "rank 0. All machines must be of one kind, and random numbers must come from "
                    "the worlds' streams, or be drawn for all rows of a batch at once."
                )

    @contextmanager
    def _together(self) -> Iterator[None]:
        """Within it all ranks must come: one that has gone, or stands still, is named so.

        Raises:
            RankLost: in place of torch's own, of many lines.
        """
        try:
            yield
        except (RuntimeError, dist.DistError) as error:
            raise RankLost(
                f"launch.ranks must all be there, rank {self.rank} of {self.size} has lost another "
                f"or waited {self.timeout:g} s for it: see that one's machine, then go on with "
                "resume."
            ) from error


Coming = list[tuple[Tensor, Draw]]  # the next one last


def _supplied(coming: Coming, draw: Draw) -> Tensor:
    if not coming or coming[-1][1] != draw:
        raise _irregular()
    return coming.pop()[0]


@contextmanager
def _all_of(coming: Coming, drawing: AbstractContextManager[Any]) -> Iterator[None]:
    with drawing:
        yield
    if coming:
        raise _irregular()


def _irregular() -> ValueError:
    return ValueError(
        "launch.ranks must be 1 for a policy that does not draw the same kinds of numbers in every "
        "step."
    )
