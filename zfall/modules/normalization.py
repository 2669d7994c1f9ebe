"""Running normalisation of observations, kept with the policy."""

from collections.abc import Callable, Iterable

import torch
from torch import Tensor, nn

Moments = tuple[int, Tensor, Tensor]  # number of rows, their mean and variance (D,)


def moments_of(rows: Tensor) -> Moments:
    """Number, mean and variance of rows ``(n, D)``, the mean of squares about the mean."""
    return len(rows), rows.mean(0), rows.var(0, unbiased=False)


def merged_moments(parts: Iterable[Moments]) -> Moments:
    """Those of the rows of all parts, one after the other (Chan et al. 1983)."""
    first, *others = parts
    count, mean, variance = first
    for more, other_mean, other_variance in others:
        share = more / max(1, count + more)
        change = other_mean - mean
        variance = (1 - share) * variance + share * other_variance
        variance = variance + share * (1 - share) * change.square()
        mean, count = mean + share * change, count + more
    return count, mean, variance


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
    def update(
        self, observation: Tensor, moments: Callable[[Tensor], Moments] = moments_of
    ) -> None:
        """Adds a batch ``(*B, D)`` to the statistics (Chan et al. 1983, parallel variance).

        Args:
            observation: of the batch.
            moments: gives those of its rows, or of more of which these are a part.

        Raises:
            ValueError: on another size.
        """
        if observation.shape[-1] != len(self.mean):
            raise ValueError(
                f"observation must have {len(self.mean)} numbers, got {observation.shape[-1]}."
            )
        count, mean, variance = moments(observation.reshape(-1, len(self.mean)).double())
        total = self.count + count
        share = count / total
        change = mean - self.mean
        merged = (1 - share) * self.variance + share * variance
        self.variance.copy_(merged + share * (1 - share) * change.square())
        self.mean.add_(share * change)
        self.count.copy_(total)
