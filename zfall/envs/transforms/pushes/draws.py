"""What random disturbances draw: ranges, headings, times."""

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor

from zfall.envs.transforms.values import two_numbers


def between(bounds: Sequence[float] | Tensor, u: Tensor) -> Tensor:
    """Uniform values ``(N,)`` between bounds (one pair for all, or ``(2, N)``), from ``u``."""
    low, high = bounds
    return low + (high - low) * u


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


def heading(direction: str | Sequence[float], u: Tensor) -> Tensor:
    """Unit vectors ``(N, 3)`` in world axes.

    Args:
        direction: ``planar``, ``spherical`` or a fixed vector.
        u: uniform numbers ``(2, N)``.

    Raises:
        ValueError: on another direction.
    """
    if not isinstance(direction, str) and len(direction) == 3 and any(direction):
        fixed = torch.tensor([float(value) for value in direction])
        return (fixed / fixed.norm()).expand(u.shape[1], 3)
    if direction not in ("planar", "spherical"):
        raise ValueError(
            f"direction must be planar, spherical or a vector [x, y, z], got {direction!r}."
        )
    angle = 2 * math.pi * u[0]
    cos, sin = angle.cos(), angle.sin()
    if direction == "planar":
        return torch.stack([cos, sin, torch.zeros_like(cos)], -1)
    z = 2.0 * u[1] - 1.0  # Archimedes: heights on a sphere are uniform
    level = (1.0 - z.square()).sqrt()
    return torch.stack([level * cos, level * sin, z], -1)


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
        self.times: Tensor | None = None
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
            self.times = torch.tensor([*times, torch.inf], dtype=torch.float64)

    def next(self, u: Tensor, rest_from: Tensor, last: Tensor, count: Tensor) -> Tensor:
        """Beginnings ``(N,)`` [s from now].

        Args:
            u: uniform numbers ``(N,)``.
            rest_from: when the rest began ``(N,)`` [s from now].
            last: when the disturbance before began, or the episode ``(N,)`` [s from now].
            count: disturbances of the episode so far ``(N,)``.
        """
        if self.times is not None:
            previous = torch.where(count > 0, self.times[(count - 1).clamp_min(0)], 0.0)
            return last + self.times[count.clamp_max(len(self.times) - 1)] - previous
        if self.mean_interval is not None:
            return rest_from - (self.mean_interval - self.mean) * torch.log1p(-u.double())
        bounds = (0.0, 0.0) if self.interval is None else self.interval
        return rest_from + between(bounds, u)
