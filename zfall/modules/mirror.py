"""The reflection of a vector at the robot's plane of symmetry."""

import torch
from torch import Tensor, nn


class Mirror(nn.Module):
    """Reflects a vector: ``clamp(factor * x[index] + summand, low, high)``.

    ``zfall.envs.mirror`` makes one for an observation or an action.

    Args:
        index: where each component of the image comes from ``(D,)``, integers.
        factor, summand: ``(D,)``; ``None``: 0.
        low, high: bounds ``(D,)``, both or neither; ``None``: none.
    """

    index: Tensor
    factor: Tensor
    summand: Tensor
    low: Tensor | None
    high: Tensor | None

    def __init__(
        self,
        index: Tensor,
        factor: Tensor,
        summand: Tensor | None = None,
        low: Tensor | None = None,
        high: Tensor | None = None,
    ):
        super().__init__()
        self.register_buffer("index", index)
        self.register_buffer("factor", factor)
        self.register_buffer("summand", torch.zeros_like(factor) if summand is None else summand)
        self.register_buffer("low", low)
        self.register_buffer("high", high)

    def stacked(self, times: int) -> "Mirror":
        """The mirror of so many vectors one behind the other ``(times * D,)``."""
        size, bounds = len(self.index), (self.low, self.high)
        index = torch.cat([self.index + number * size for number in range(times)])
        low, high = (None if bound is None else bound.repeat(times) for bound in bounds)
        return Mirror(index, self.factor.repeat(times), self.summand.repeat(times), low, high)

    def forward(self, vector: Tensor) -> Tensor:
        """The vector ``(*B, D)`` of the robot in the mirror."""
        image = vector.index_select(-1, self.index) * self.factor + self.summand
        return image if self.low is None else image.clamp(self.low, self.high)
