"""A mixture of Gaussians over the whole action."""

from itertools import combinations

import torch
from torch import Tensor
from torch.distributions import Distribution, constraints, register_kl

from zfall.modules.mixture import HALF_LOG_2PI

_CLIMB = 60  # steps of the mean shift


class SharedMixtureOfGaussians(Distribution):
    """A mixture of K Gaussians over the whole action: all joints are of the same component.

    Only such a one can choose between two ways to act, a step to the left or one to the right.
    Entropy and divergence have no closed form and too many dimensions for quadrature: they are
    estimates without bias in value and gradient, from one reparameterised draw of every
    component, ``sum_k w_k f(mu_k + sigma_k e_k)``. There is no ``rsample``: a draw of all joints
    jumps from component to component.

    Args:
        logits: unnormalised log weights ``(*B, K)``.
        loc: means ``(*B, K, J)``.
        scale: standard deviations ``(*B, K, J)``, positive.
        statistic: what the policy does when it does not explore, ``mean`` or ``mode``.
    """

    arg_constraints: dict[str, constraints.Constraint] = {}
    support = constraints.independent(constraints.real, 1)
    has_rsample = False

    def __init__(self, logits: Tensor, loc: Tensor, scale: Tensor, statistic: str = "mean"):
        self.statistic = statistic
        self.logits, self.loc, self.scale = logits, loc, scale
        self._log_weight = logits.log_softmax(-1)
        joints = loc.shape[-1]
        self._log_factor = self._log_weight - scale.log().sum(-1) - joints * HALF_LOG_2PI
        super().__init__(loc.shape[:-2], loc.shape[-1:], validate_args=False)

    def _component_log_prob(self, value: Tensor) -> Tensor:
        """Log of weight x density of each component ``(..., K)`` at ``value`` ``(..., J)``."""
        deviation = (value.unsqueeze(-2) - self.loc) / self.scale
        return self._log_factor - 0.5 * deviation.square().sum(-1)

    def log_prob(self, value: Tensor) -> Tensor:
        """Log density ``(*B,)`` of actions ``(*B, J)``."""
        return self._component_log_prob(value).logsumexp(-1)

    @torch.no_grad()
    def sample(self, sample_shape: torch.Size | list[int] | tuple[int, ...] = ()) -> Tensor:
        """Draws ``(*sample_shape, *B, J)``; the component by inversion of its distribution."""
        shape, below = torch.Size(sample_shape), self._log_weight.exp().cumsum(-1)
        # Above 0 and up to the last, 1 but for rounding: nothing without weight is drawn.
        share = below[..., -1:] * (1 - below.new_empty(*shape, *below.shape[:-1], 1).uniform_())
        index = (share > below[..., :-1]).sum(-1)[..., None, None]
        index = index.expand(*index.shape[:-1], self.loc.shape[-1])
        loc = self.loc.expand(shape + self.loc.shape).gather(-2, index).squeeze(-2)
        scale = self.scale.expand(shape + self.scale.shape).gather(-2, index).squeeze(-2)
        return loc + scale * torch.randn_like(loc)

    def rsample(self, sample_shape: torch.Size | list[int] | tuple[int, ...] = ()) -> Tensor:
        """Refused: a draw has no gradient.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            "rsample must not be called on a mixture over the whole action, whose draws jump from "
            "component to component: use log_prob, or a plain Gaussian (actor.components=0) for "
            "losses that need rsample, as SAC does."
        )

    @property
    def mean(self) -> Tensor:
        """Mean ``(*B, J)``."""
        return (self._log_weight.exp().unsqueeze(-1) * self.loc).sum(-2)

    @property
    def variance(self) -> Tensor:
        """Variance of each joint ``(*B, J)``: within the components and between them."""
        deviation = self.loc - self.mean.unsqueeze(-2)
        weight = self._log_weight.exp().unsqueeze(-1)
        return (weight * (self.scale.square() + deviation.square())).sum(-2)

    @property
    def mode(self) -> Tensor:
        """Most likely action ``(*B, J)``: the highest of the maxima that climbers find.

        They climb by the mean-shift fixed point from the mean of every component and from between
        every two, where the product of their densities is highest. In several dimensions a mixture
        may have a maximum that none of them leads to.

        Source: Ray & Lindsay, "The topography of multivariate normal mixtures", Annals of
        Statistics 2005: between two components maxima lie on the curve of weighted such points.
        """
        precision = self.scale.square().reciprocal()
        means, narrow = self.loc.unbind(-2), precision.unbind(-2)
        pairs = combinations(range(len(means)), 2)
        between = [
            (narrow[i] * means[i] + narrow[j] * means[j]) / (narrow[i] + narrow[j])
            for i, j in pairs
        ]
        value = torch.stack([*means, *between])  # the climbers
        for _ in range(_CLIMB):
            weight = self._component_log_prob(value).softmax(-1).unsqueeze(-1) * precision
            value = (weight * self.loc).sum(-2) / weight.sum(-2)
        best = self.log_prob(value).argmax(0)[None, ..., None].expand(1, *value.shape[1:])
        return value.gather(0, best).squeeze(0)

    @property
    def deterministic_sample(self) -> Tensor:
        """What the policy does when it does not explore."""
        return self.mode if self.statistic == "mode" else self.mean

    def entropy(self) -> Tensor:
        """Estimate of the entropy ``(*B,)`` with a gradient."""
        return -self._expectation(self.log_prob(self._draw_each()))

    def kl(self, other: "SharedMixtureOfGaussians") -> Tensor:
        """Estimate of ``KL(self || other)`` ``(*B,)`` with a gradient in both."""
        draws = self._draw_each()
        return self._expectation(self.log_prob(draws) - other.log_prob(draws))

    def _draw_each(self) -> Tensor:
        """One draw of every component ``(K, *B, J)``."""
        return (self.loc + self.scale * torch.randn_like(self.loc)).movedim(-2, 0)

    def _expectation(self, value: Tensor) -> Tensor:
        """Mean over components of a value ``(K, *B)`` at their draws."""
        return (self._log_weight.movedim(-1, 0).exp() * value).sum(0)


register_kl(SharedMixtureOfGaussians, SharedMixtureOfGaussians)(SharedMixtureOfGaussians.kl)
