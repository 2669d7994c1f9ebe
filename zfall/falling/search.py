"""Searches movements by the cross-entropy method, and those that catch a fall.

Source: Rubinstein, "The cross-entropy method for combinatorial and continuous optimization",
Methodology and Computing in Applied Probability 1999.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise, product
from typing import NamedTuple

import torch
from torch import Tensor

from zfall.errors import check_number
from zfall.falling.movements import HEADINGS, Catches
from zfall.falling.recorded_falls import Falls, caught

# How good movements (N, K, J) [rad] are on rows (N,), the higher the better (N,).
Score = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True, kw_only=True)
class CrossEntropySearch:
    """Varies the best of many movements, round after round, each tried on a few starts.

    Args:
        candidates: movements of a round.
        trials: starts that each is tried on, other ones in every round.
        elite: best movements of a round, which are kept and give the next its mean and spread.
        rounds: number of rounds.
        spread: standard deviation of the first round [rad].
        seed: of the movements and of the starts.

    Raises:
        ValueError: on a number that no search can have.
    """

    candidates: int = 256
    trials: int = 4
    elite: int = 24
    rounds: int = 20
    spread: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("candidates", "trials", "rounds"):
            check_number(getattr(self, name), name, lambda x: x >= 1, "be at least 1")
        check_number(self.spread, "spread", lambda x: 0 < x < math.inf, "be positive and finite")
        if not 2 <= self.elite <= self.candidates:
            raise ValueError(f"elite must lie in [2, candidates], got {self.elite}.")

    def __call__(self, score: Score, rows: Tensor, mean: Tensor, joint_range: Tensor) -> Tensor:
        """The mean of the best movements ``(K, J)`` [rad].

        Args:
            score: of ``candidates * trials`` movements, of which each is tried on its row.
            rows: starts to be tried, for instance of a bank.
            mean: where the search begins ``(K, J)`` [rad].
            joint_range: least and largest angle of each joint ``(J, 2)`` [rad].
        """
        generator = torch.Generator().manual_seed(self.seed)
        low, high = joint_range.unbind(-1)
        std, kept = torch.full_like(mean, self.spread), mean[None]
        for _ in range(self.rounds):
            noise = torch.randn((self.candidates, *mean.shape), generator=generator)
            moves = (mean + std * noise).clamp(low, high)
            moves[: len(kept)] = kept
            tried = rows[torch.randint(len(rows), (self.trials,), generator=generator)]
            each = score(tried.repeat(self.candidates), moves.repeat_interleave(self.trials, 0))
            best = each.view(self.candidates, self.trials).mean(1).topk(self.elite)
            kept = moves[best.indices]
            mean, std = kept.mean(0), 0.9 * kept.std(0) + 0.02
        return mean


class Outcome(NamedTuple):
    """What comes of a movement on many falls.

    Attributes:
        score: mean of ``Landing.score``.
        kneels: share that ends in a kneel.
        force: mean of the largest force on torso or head [N].
        acceleration: mean of the largest acceleration of the base [m/s2].
    """

    score: float
    kneels: float
    force: float
    acceleration: float

    def __str__(self) -> str:
        return f"{self.kneels:.2f} kneel, mean {self.force:.0f} N, {self.acceleration:.0f} m/s2"


class Attempt(NamedTuple):
    """A search for the falls of one heading and one range of speed.

    Attributes:
        heading: [degrees].
        speed: least of the range [m/s].
        falls: how many there are.
        before, after: of the movement known before and of that found; ``None`` if there were
            fewer falls than the search has trials, and nothing was searched.
    """

    heading: int
    speed: float
    falls: int
    before: Outcome | None = None
    after: Outcome | None = None

    @property
    def better(self) -> bool:
        """Whether the movement that was found has taken the place of the other."""
        if self.before is None or self.after is None:
            return False
        return self.after.score > self.before.score

    def __str__(self) -> str:
        place = f"{self.heading} degrees, from {self.speed:g} m/s: {self.falls} falls"
        if self.before is None:
            return f"{place}, left as is"
        kept = "" if self.better else ", left as is"
        return f"{place}, before {self.before}; after {self.after}{kept}"


def check_bins(headings: Sequence[int], speeds: Sequence[float], until: Sequence[float]) -> None:
    """Refuses headings that no movement is for, and bounds that do not rise.

    Raises:
        ValueError: naming the key.
    """
    if not headings or any(heading not in HEADINGS for heading in headings):
        raise ValueError(f"headings must be some of 0, 30, ... 330 degrees, got {headings}.")
    for name, values in (("until", until), ("speeds", speeds)):
        if sorted(values) != list(values):
            raise ValueError(f"{name} must rise, got {list(values)}.")


def first_guess(
    known: Catches | None,
    stand: Tensor | Sequence[float],
    until: Sequence[float],
    speeds: Sequence[float],
) -> Catches:
    """Movements from which a search goes on.

    Args:
        known: movements that there are; ``None``: the robot stands still.
        stand: the standing pose ``(J,)`` [rad].
        until: when each posture but the last ends [s].
        speeds: between the bins of speed [m/s].
    """
    ends, bins = torch.tensor([*until, torch.inf]), len(speeds) + 1
    postures = torch.as_tensor(stand).float().repeat(len(HEADINGS), bins, len(ends), 1)
    if known is not None:
        of_bin = torch.arange(bins).clamp(max=known.postures.shape[1] - 1)
        of_time = torch.arange(len(ends)).clamp(max=known.postures.shape[2] - 1)
        postures[:] = known.postures[:, of_bin][:, :, of_time]
    return Catches(postures, ends, torch.tensor(list(speeds)))


def improve(
    catches: Catches,
    falls: Falls,
    search: CrossEntropySearch,
    headings: Sequence[int] = HEADINGS,
    *,
    begin: int = 0,
) -> Iterator[Attempt]:
    """Searches a movement for each heading and range of speed; keeps the known one if it is better.

    Args:
        catches: their ``postures`` are replaced, one movement after each step of the iterator.
        falls: of an env of ``candidates * trials`` worlds.
        search: what looks for each of them.
        headings: some of ``HEADINGS`` [degrees].
        begin: number of attempts that are over.
    """

    def score(rows: Tensor, moves: Tensor) -> Tensor:
        return caught(falls, rows, moves, catches.until).score

    edges = [0.0, *catches.speeds.tolist(), math.inf]
    attempts = product(headings, enumerate(pairwise(edges)))
    for heading, (j, (low, high)) in islice(attempts, begin, None):
        falls.worlds.env.set_seed(search.seed)  # so that each attempt is the same by itself
        rows, place = falls.like(heading, low, high), (HEADINGS.index(heading), j)
        attempt = Attempt(heading, low, len(rows))
        if len(rows) >= search.trials:
            known = catches.postures[place]
            before = _outcome(falls, rows, known, catches.until)
            move = search(score, rows, known, falls.env.joint_range)
            after = _outcome(falls, rows, move, catches.until)
            attempt = attempt._replace(before=before, after=after)
            if attempt.better:
                catches.postures[place] = move
        yield attempt


def _outcome(falls: Falls, rows: Tensor, move: Tensor, until: Tensor) -> Outcome:
    """What comes of one movement ``(K, J)`` on all these falls."""
    some = rows[torch.arange(falls.env.num_envs) % len(rows)]
    landing = caught(falls, some, move.expand(len(some), -1, -1), until)
    values = (landing.score, landing.kneels.float(), landing.force, landing.acceleration)
    return Outcome(*(value.mean().item() for value in values))
