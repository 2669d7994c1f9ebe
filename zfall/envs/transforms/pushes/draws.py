"""What random disturbances draw: ranges, headings, times."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from zfall.envs.streams import Stream
from zfall.envs.transforms.values import two_numbers


def between(bounds: Any, u: Any) -> Any:
    """Uniform values ``(N,)`` between bounds (one pair for all, or ``(2, N)``), from ``u``.

    Of torch or of NumPy, as what it is given.
    """
    low, high = bounds
    return low + (high - low) * u


def of_worlds(value: Any, index: NDArray[np.int64]) -> Any:
    """A number or bounds of the worlds in ``index`` ``(K,)``.

    As it is, if it is the same for all; of a tensor ``(..., N)``, which a curriculum makes of it,
    these columns ``(..., K)``.
    """
    return value.numpy()[..., index] if isinstance(value, Tensor) else value


def uniform(
    count: int, rows: Tensor, stream: Stream
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Uniform numbers for the few worlds that need some.

    What is made of them takes a third of the time in NumPy, as each operation is on a few numbers.

    Args:
        count: numbers per world.
        rows: which worlds ``(N,)`` bool.
        stream: where they come from.

    Returns:
        Which worlds ``(K,)``, and their numbers ``(count, K)``.
    """
    index = rows.numpy().nonzero()[0]
    return index, np.ascontiguousarray(stream.uniform((count,), rows).numpy()[index].T)


def check_range(
    name: str, bounds: Sequence[float], *, positive: bool = False, negative: bool = False
) -> None:
    """Raises ``ValueError`` unless ``bounds`` are two values in order.

    Args:
        name: of the parameter.
        bounds: smallest and largest value.
        positive: whether 0 is refused.
        negative: whether values below 0 are allowed.
    """
    rule = f"{name} must be [smallest, largest]"
    low, high = two_numbers(name, bounds)
    if not low <= high:
        raise ValueError(f"{rule}, got {[low, high]}.")
    if positive and not low > 0:
        raise ValueError(f"{name} must be positive, got {[low, high]}.")
    if not negative and low < 0:
        raise ValueError(f"{rule} of values that are not negative, got {[low, high]}.")


def heading(direction: str | Sequence[float], u: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unit vectors ``(N, 3)`` in world axes.

    Args:
        direction: ``planar``, ``spherical`` or a fixed vector.
        u: uniform numbers ``(2, N)``; ``planar`` needs the first row alone.

    Raises:
        ValueError: on another direction.
    """
    if not isinstance(direction, str) and len(direction) == 3 and any(direction):
        fixed = np.array(direction, np.float32)
        return np.broadcast_to(fixed / np.linalg.norm(fixed), (u.shape[1], 3))
    if direction not in ("planar", "spherical"):
        raise ValueError(
            f"direction must be planar, spherical or a vector [x, y, z], got {direction!r}."
        )
    angle = 2 * math.pi * u[0]
    cos, sin = np.cos(angle), np.sin(angle)
    if direction == "planar":
        return np.stack([cos, sin, np.zeros_like(cos)], -1)
    z = 2.0 * u[1] - 1.0  # Archimedes: heights on a sphere are uniform
    level = np.sqrt(1.0 - z * z)
    return np.stack([level * cos, level * sin, z], -1)


class Timing:
    """When the next disturbance begins.

    Args:
        interval: shortest and longest rest before it [s]; or
        mean_interval: mean time from one beginning to the next [s], of exponential rests; or
        times: beginnings [s since the episode began].
        longest: longest duration of the disturbance [s].
        mean: mean duration of it [s].
        control_dt: time between two plans [s]: the next one is made once the last has ended.

    Raises:
        ValueError: if not just one is given, or two disturbances would overlap.
    """

    def __init__(
        self,
        interval: Sequence[float] | None,
        mean_interval: float | None,
        times: Sequence[float] | None,
        *,
        longest: float,
        mean: float,
        control_dt: float,
    ):
        options = {"interval": interval, "mean_interval": mean_interval, "times": times}
        given = [name for name, value in options.items() if value is not None]
        if len(given) != 1:
            raise ValueError(
                f"give just one of {', '.join(options)}, got {', '.join(given) or 'none'}."
            )
        self.interval, self.mean_interval, self.mean = interval, mean_interval, mean
        self.times: NDArray[np.float64] | None = None
        if interval is not None:
            check_range("interval", interval)
        elif mean_interval is not None:
            if not mean_interval > longest:
                raise ValueError(
                    f"mean_interval must be longer than a push ({longest}), got {mean_interval}."
                )
        elif times is not None:
            gaps = [b - a for a, b in pairwise(times)]
            least = longest + control_dt
            if not times or times[0] < 0 or any(gap < least - 1e-9 for gap in gaps):
                raise ValueError(
                    f"times must grow from 0 on by at least duration + control_dt ({least:g}), "
                    f"got {list(times)}; ScriptedPush takes pushes that overlap."
                )
            self.times = np.array([*times, np.inf])

    def next(
        self,
        index: NDArray[np.int64],
        u: NDArray[np.float32],
        rest_from: Tensor,
        last: Tensor,
        count: Tensor,
    ) -> NDArray[np.float64]:
        """Beginnings ``(K,)`` [s from now].

        Args:
            index: worlds that need one ``(K,)``.
            u: their uniform numbers ``(K,)``.
            rest_from: when the rest of each world began ``(N,)`` [s from now].
            last: when the disturbance before began, or the episode ``(N,)`` [s from now].
            count: disturbances of the episode so far ``(N,)``.
        """
        if self.times is not None:
            done = count.numpy()[index]
            previous = np.where(done > 0, self.times[(done - 1).clip(0)], 0.0)
            return last.numpy()[index] + self.times[done.clip(max=len(self.times) - 1)] - previous
        begun = rest_from.numpy()[index]
        if self.mean_interval is not None:
            mean = of_worlds(self.mean_interval, index) - self.mean
            return begun - mean * np.log1p(-u.astype(np.float64))
        return begun + between(of_worlds(self.interval, index), u)
