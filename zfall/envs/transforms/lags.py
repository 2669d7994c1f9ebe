"""Delays in seconds, drawn for each world and rounded to physics steps."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from zfall.envs.streams import Stream
from zfall.envs.transforms.values import per_world, two_numbers


class Lags:
    """Draws delays, uniform between bounds, as whole numbers of physics steps.

    Args:
        delay: shortest and longest delay [s].
        max_delay: largest value that ``delay`` may be given later [s].
        per: ``episode`` or ``step``, how long a delay holds.
        physics_dt: physics step [s].

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
    ):
        low, high = two_numbers("delay", delay)
        if not 0 <= low <= high <= max_delay:
            raise ValueError(
                f"delay must be [shortest, longest] within [0, max_delay], got {[low, high]} "
                f"with max_delay {max_delay}."
            )
        if per not in ("episode", "step"):
            raise ValueError(f"per must be episode or step, got {per!r}.")
        self.per, self.physics_dt = per, physics_dt
        self.max_delay, self.longest = max_delay, round(max_delay / physics_dt)

    def ring(self, substeps: int, more: int) -> int:
        """Physics steps that a ring must hold for the longest delay and ``more`` steps besides.

        A multiple of ``substeps``, so that the steps of a control step lie side by side in it.
        """
        return substeps * math.ceil((self.longest + more) / substeps)

    def draw(
        self,
        delay: Sequence[float] | Tensor,
        shape: tuple[int, ...],
        stream: Stream,
        rows: Tensor | None = None,
    ) -> Tensor:
        """Lags of ``shape`` ``(N,)`` or ``(N, J)`` [physics steps].

        Args:
            delay: bounds [s], one pair for all worlds or ``(2, N)``.
            shape: that of the result.
            stream: where random numbers come from.
            rows: the worlds that draw, the others get the shortest; all if ``None``.

        Raises:
            ValueError: if a delay lies outside [0, max_delay].
        """
        low, high = (per_world(bound, len(shape)) for bound in delay)
        seconds = low + (high - low) * stream.uniform(shape[1:], rows)
        lag = torch.round(seconds / self.physics_dt).long()
        least, most = (float(bound) for bound in seconds.aminmax())
        if least < 0 or most > self.max_delay + 1e-6:  # float32
            raise ValueError(
                f"delay must stay within [0, max_delay], got [{least:g}, {most:g}] "
                f"with max_delay {self.max_delay:g}."
            )
        return lag.clamp_max(self.longest)
