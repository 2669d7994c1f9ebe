"""Averages of weights over updates."""

from collections.abc import Callable

import torch
from torch import Tensor


def moving_average(decay: float) -> Callable[..., None]:
    """Rule of an exponential average whose weights sum to one from the first update on.

    After n updates that of k updates ago weighs ``decay^k (1 - decay) / (1 - decay^n)``; torch's
    own rule gives ``decay^(n - 1)`` to the first one, a third of all after 60 updates at 0.98.
    """

    @torch.no_grad()
    def update(averaged: list[Tensor], current: list[Tensor], count: Tensor) -> None:
        weight = (1 - decay) / (1 - decay ** (int(count) + 1))
        torch._foreach_lerp_(averaged, current, weight)

    return update
