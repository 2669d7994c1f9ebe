"""Delays in seconds, drawn for each world and rounded to physics steps."""

from collections.abc import Sequence

import torch
from torch import Tensor

from zfall.envs.transforms.values import per_world


class Lags:
    """Draws delays, uniform between bounds, as whole numbers of physics steps.

    Args:
        delay: shortest and longest delay [s].
        max_delay: largest value that ``delay`` may be given later [s].
        per: ``episode`` or ``step``, how long a delay holds.
        physics_dt: physics step [s].
        rng: where random numbers come from.

    Raises:
        ValueError: if the delays are not in order within [0, max_delay], or ``per`` is unknown.
    """

    def __init__(
        self,
        delay: Sequence[float],
        *,
        max_delay: float,
        per: str,
        physics_dt: float,
        rng: torch.Generator,
    ):
        if len(delay) != 2 or not 0 <= delay[0] <= delay[1] <= max_delay:
            raise ValueError(
                f"delay must be [shortest, longest] within [0, max_delay], got {list(delay)} "
                f"with max_delay {max_delay}."
            )
        if per not in ("episode", "step"):
            raise ValueError(f"per must be episode or step, got {per!r}.")
        self.per, self.physics_dt, self.rng = per, physics_dt, rng
        self.longest = round(max_delay / physics_dt)

    def draw(self, delay: Sequence[float] | Tensor, shape: tuple[int, ...]) -> Tensor:
        """Lags of ``shape`` ``(N,)`` or ``(N, J)`` [physics steps].

        Args:
            delay: bounds [s], one pair for all worlds or ``(2, N)``.
            shape: that of the result.

        Raises:
            ValueError: if a delay lies outside [0, max_delay].
        """
        low, high = (per_world(bound, len(shape)) for bound in delay)
        seconds = low + (high - low) * torch.rand(shape, generator=self.rng)
        lag = torch.round(seconds / self.physics_dt).long()
        if int(lag.amin()) < 0 or int(lag.amax()) > self.longest:
            limit = self.longest * self.physics_dt
            raise ValueError(
                f"delay must stay within [0, max_delay], got [{float(seconds.amin()):g}, "
                f"{float(seconds.amax()):g}] with max_delay {limit:g}."
            )
        return lag
