"""Random numbers of each world, for each purpose."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zfall.simulation.philox import fill_integers, fill_normal, fill_uniform

_WORD = 2**64 - 1


class Streams:
    """A stream of random numbers for each world and purpose, fixed by the seed.

    Number n of a stream follows from (seed, world, purpose, n) alone. A world draws the same
    numbers whatever worlds are next to it, however often these begin anew, and whatever is drawn
    for other purposes.

    Args:
        num_envs: number of worlds N.
    """

    def __init__(self, num_envs: int):
        self._all = np.ones(num_envs, np.bool_)
        self.begin(0)

    def begin(self, seed: int, worlds: Sequence[int] | NDArray[np.int64] | None = None) -> None:
        """Begins all streams.

        Args:
            seed: of all of them.
            worlds: which each world is ``(N,)``, numbers from 0 on; ``None``: 0 to N - 1.

        Raises:
            ValueError: if there is not one number from 0 on for each world.
        """
        numbers = np.arange(len(self._all)) if worlds is None else np.array(worlds, dtype=np.int64)
        if numbers.shape != self._all.shape or (numbers < 0).any():
            raise ValueError(
                f"worlds must be {len(self._all)} numbers from 0 on, got {numbers.tolist()}."
            )
        self.seed, self._worlds = int(seed) & _WORD, numbers
        self._at: dict[str, NDArray[np.int64]] = {}  # next counter of each world

    def of(self, purpose: str) -> "Stream":
        """Those for one purpose, in all worlds."""
        return Stream(self, purpose)

    def draw(
        self,
        fill: Callable[..., None],
        dtype: type,
        purpose: str,
        shape: Sequence[int],
        rows: Tensor | None,
        *args: Any,
    ) -> Tensor:
        """Numbers ``(N, *shape)`` by a function of ``zfall.simulation.philox``; 0 elsewhere."""
        at = self._at.get(purpose)
        if at is None:
            at = self._at[purpose] = np.zeros(len(self._all), np.int64)
        mask = self._all if rows is None else np.ascontiguousarray(rows.numpy())
        out: NDArray[Any] = np.zeros((len(self._all), int(np.prod(shape))), dtype)
        fill(out, mask, self._worlds, at, np.uint64(self.seed), _number_of(purpose), *args)
        return torch.from_numpy(out.reshape(len(self._all), *shape))

    def state_dict(self) -> dict[str, Any]:
        """How far all streams have come."""
        return {
            "seed": self.seed,
            "worlds": torch.from_numpy(self._worlds.copy()),
            "at": {purpose: torch.from_numpy(at.copy()) for purpose, at in self._at.items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from what ``state_dict`` gave.

        Raises:
            ValueError: if it is of another number of worlds, or lacks a part.
        """
        self.check_state(state)
        self.begin(state["seed"], state["worlds"].numpy())
        self._at = {purpose: at.numpy().copy() for purpose, at in state["at"].items()}

    def check_state(self, state: Mapping[str, Any]) -> None:
        """Raises ``ValueError`` unless ``load_state_dict`` can restore a state."""
        for name in ("seed", "worlds", "at"):
            if name not in state:
                raise ValueError(f"an env's state must have streams.{name}, got none.")
        for name, value in {"worlds": state["worlds"], **state["at"]}.items():
            if value.shape != self._all.shape:
                raise ValueError(
                    f"an env's state must be of as many worlds, streams of {len(self._all)}, "
                    f"got {len(value)} in {name}."
                )


class Stream(NamedTuple):
    """The streams of all worlds for one purpose.

    Each draw moves on the streams of the worlds that draw, and no others.
    """

    streams: Streams
    purpose: str

    def uniform(self, shape: Sequence[int] = (), rows: Tensor | None = None) -> Tensor:
        """Uniform numbers in [0, 1) ``(N, *shape)``.

        Args:
            shape: of the numbers of a world.
            rows: the worlds that draw ``(N,)`` bool, the others get 0; all if ``None``.
        """
        return self.streams.draw(fill_uniform, np.float32, self.purpose, shape, rows)

    def normal(self, shape: Sequence[int] = (), rows: Tensor | None = None) -> Tensor:
        """Numbers from N(0, 1) ``(N, *shape)``, arguments as in ``uniform``."""
        return self.streams.draw(fill_normal, np.float32, self.purpose, shape, rows)

    def integers(self, high: int, shape: Sequence[int] = (), rows: Tensor | None = None) -> Tensor:
        """Whole numbers from 0 to ``high - 1`` ``(N, *shape)`` int64, arguments as in ``uniform``.

        Raises:
            ValueError: if there are none.
        """
        if high < 1:
            raise ValueError(f"high must be at least 1, got {high}.")
        draw = self.streams.draw
        return draw(fill_integers, np.int64, self.purpose, shape, rows, np.uint64(high))


@cache
def _number_of(purpose: str) -> np.uint64:
    """A word that stands for a purpose, the same in every process."""
    digest = hashlib.blake2b(purpose.encode(), digest_size=8).digest()
    return np.uint64(int.from_bytes(digest, "little"))
