"""Running normalisation of observations, kept with the policy."""

import torch
from torch import Tensor, nn


class ObservationNormalizer(nn.Module):
    """Centers and scales observations by their mean and standard deviation so far.

    The statistics are buffers, saved with the policy. They change in ``update`` alone, called
    once per batch after learning, so that a batch is learned with the statistics it was
    collected with.

    Args:
        size: length D of the observation.
        clip: bound on the normalised values.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, size: int, clip: float = 10.0):
        super().__init__()
        self.clip = clip
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("variance", torch.ones(size))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    def forward(self, observation: Tensor) -> Tensor:
        """Normalised observation, shape ``(*B, D)`` kept."""
        scaled = (observation - self.mean) / self.scale
        return scaled.clamp(-self.clip, self.clip)

    @property
    def scale(self) -> Tensor:
        """Standard deviation so far ``(D,)``, what a normalised value of 1 stands for."""
        return (self.variance + 1e-6).sqrt()

    @torch.no_grad()
    def update(self, observation: Tensor) -> None:
        """Adds a batch ``(*B, D)`` to the statistics (Chan et al. 1983, parallel variance)."""
        flat = observation.reshape(-1, len(self.mean)).double()
        count, mean, variance = len(flat), flat.mean(0), flat.var(0, unbiased=False)
        total = self.count + count
        share = count / total
        change = mean - self.mean
        merged = (1 - share) * self.variance + share * variance
        self.variance.copy_(merged + share * (1 - share) * change.square())
        self.mean.add_(share * change)
        self.count.copy_(total)
