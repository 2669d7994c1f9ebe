"""Mixtures of Gaussians as action distributions."""

import math

import torch
from torch import Tensor
from torch.distributions import Distribution, constraints

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)


class MixtureOfGaussians(Distribution):
    """For every joint on its own, a mixture of K Gaussians.

    Args:
        logits: unnormalised log weights ``(*B, J, K)``.
        loc: means ``(*B, J, K)``.
        scale: standard deviations ``(*B, J, K)``, positive.
        statistic: what the policy does when it does not explore, ``mean`` or ``mode``.
    """

    arg_constraints: dict[str, constraints.Constraint] = {}
    support = constraints.independent(constraints.real, 1)
    has_rsample = False

    def __init__(self, logits: Tensor, loc: Tensor, scale: Tensor, statistic: str = "mean"):
        self.statistic = statistic
        self.log_weight, self.loc, self.scale = logits.log_softmax(-1), loc, scale
        super().__init__(loc.shape[:-2], loc.shape[-2:-1], validate_args=False)

    def _component_log_prob(self, value: Tensor) -> Tensor:
        """Log of weight x density of each component at ``value`` ``(..., J)``."""
        z = (value.unsqueeze(-1) - self.loc) / self.scale
        return self.log_weight - 0.5 * z.square() - self.scale.log() - _HALF_LOG_2PI

    def log_prob(self, value: Tensor) -> Tensor:
        """Log density ``(*B,)`` of actions ``(*B, J)``, summed over joints."""
        return self._component_log_prob(value).logsumexp(-1).sum(-1)

    @torch.no_grad()
    def sample(self, sample_shape: torch.Size | list[int] | tuple[int, ...] = ()) -> Tensor:
        """Draws ``(*sample_shape, *B, J)``; the component by the Gumbel-max trick."""
        shape = torch.Size(sample_shape) + self.loc.shape
        gumbel = -torch.empty(shape, device=self.loc.device).exponential_().log()
        index = (self.log_weight + gumbel).argmax(-1, keepdim=True)
        loc = self.loc.expand(shape).gather(-1, index).squeeze(-1)
        scale = self.scale.expand(shape).gather(-1, index).squeeze(-1)
        return loc + scale * torch.randn(loc.shape, device=loc.device)

    @property
    def mean(self) -> Tensor:
        """Mean of each joint ``(*B, J)``."""
        return (self.log_weight.exp() * self.loc).sum(-1)

    @property
    def variance(self) -> Tensor:
        """Variance of each joint ``(*B, J)``: within the components and between them."""
        deviation = self.loc - self.mean.unsqueeze(-1)
        return (self.log_weight.exp() * (self.scale.square() + deviation.square())).sum(-1)

    @property
    def mode(self) -> Tensor:
        """Most likely value of each joint ``(*B, J)``.

        Climbs from the mean of every component by the mean-shift fixed point, which never loses
        density, and keeps the highest end.
        """
        start = self.loc.movedim(-1, 0)  # one climber per component
        value = start
        for _ in range(20):
            weight = (self._component_log_prob(value)).softmax(-1) / self.scale.square()
            value = (weight * self.loc).sum(-1) / weight.sum(-1)
        best = self._component_log_prob(value).logsumexp(-1).argmax(0, keepdim=True)
        return value.gather(0, best).squeeze(0)

    @property
    def deterministic_sample(self) -> Tensor:
        """What the policy does when it does not explore."""
        return self.mode if self.statistic == "mode" else self.mean

    def entropy(self) -> Tensor:
        """Estimate of the entropy ``(*B,)`` with a gradient, summed over joints.

        One reparameterised draw from every component: ``-sum_k w_k log p(mu_k + sigma_k e)``,
        without bias in value and gradient.
        """
        value = (self.loc + self.scale * torch.randn_like(self.loc)).movedim(-1, 0)
        log_prob = self._component_log_prob(value).logsumexp(-1).movedim(0, -1)
        return -(self.log_weight.exp() * log_prob).sum((-2, -1))
