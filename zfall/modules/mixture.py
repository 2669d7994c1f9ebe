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
        self.logits, self.loc, self.scale = logits, loc, scale
        # Components first, in memory too: elementwise work on K of (*B, J) runs several times as
        # fast as on a last axis of length K.
        self._log_weight = logits.movedim(-1, 0).contiguous().log_softmax(0)
        self._loc, self._scale = (x.movedim(-1, 0).contiguous() for x in (loc, scale))
        self._log_factor = self._log_weight - self._scale.log() - _HALF_LOG_2PI
        super().__init__(loc.shape[:-2], loc.shape[-2:-1], validate_args=False)

    def _component_log_prob(self, value: Tensor) -> Tensor:
        """Log of weight x density of each component ``(K, ..., J)`` at ``value`` ``(..., J)``."""
        # The components' axis goes in front of those that value has in front of the batch's.
        extra = value.dim() - self._loc.dim() + 1
        loc, scale, factor = (
            x.reshape(len(x), *(1,) * extra, *x.shape[1:]) if extra else x
            for x in (self._loc, self._scale, self._log_factor)
        )
        return factor - 0.5 * ((value - loc) / scale).square()

    def log_prob(self, value: Tensor) -> Tensor:
        """Log density ``(*B,)`` of actions ``(*B, J)``, summed over joints."""
        return self._component_log_prob(value).logsumexp(0).sum(-1)

    @torch.no_grad()
    def sample(self, sample_shape: torch.Size | list[int] | tuple[int, ...] = ()) -> Tensor:
        """Draws ``(*sample_shape, *B, J)``; the component by the Gumbel-max trick."""
        shape = torch.Size(sample_shape) + self.loc.shape
        gumbel = -torch.empty(shape, device=self.loc.device).exponential_().log()
        log_weight = self._log_weight.movedim(0, -1)
        index = (log_weight + gumbel).argmax(-1, keepdim=True)
        loc = self.loc.expand(shape).gather(-1, index).squeeze(-1)
        scale = self.scale.expand(shape).gather(-1, index).squeeze(-1)
        return loc + scale * torch.randn(loc.shape, device=loc.device)

    @property
    def mean(self) -> Tensor:
        """Mean of each joint ``(*B, J)``."""
        return (self._log_weight.exp() * self._loc).sum(0)

    @property
    def variance(self) -> Tensor:
        """Variance of each joint ``(*B, J)``: within the components and between them."""
        deviation = self._loc - self.mean
        return (self._log_weight.exp() * (self._scale.square() + deviation.square())).sum(0)

    @property
    def mode(self) -> Tensor:
        """Most likely value of each joint ``(*B, J)``.

        Climbs from the mean of every component by the mean-shift fixed point, which never loses
        density, and keeps the highest end.
        """
        value = self._loc  # one climber per component
        loc, precision = self._loc.unsqueeze(1), self._scale.square().reciprocal().unsqueeze(1)
        for _ in range(20):
            weight = self._component_log_prob(value).softmax(0) * precision
            value = (weight * loc).sum(0) / weight.sum(0)
        best = self._component_log_prob(value).logsumexp(0).argmax(0, keepdim=True)
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
        value = self._loc + self._scale * torch.randn_like(self._loc)
        log_prob = self._component_log_prob(value).logsumexp(0)
        return -(self._log_weight.exp() * log_prob).sum((0, -1))
