"""From a network's features to the parameters of a distribution over actions."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, TypedDict

import torch
from torch import Tensor, nn
from torchrl.modules import IndependentNormal

from zfall.modules.mixture import MixtureOfGaussians
from zfall.modules.shared_mixture import SharedMixtureOfGaussians
from zfall.values import INFINITE, ORDERED, NotNegative, Positive, Whole


class _Bounded(torch.autograd.Function):
    """``clamp(value, low, high)`` that lets a gradient through which leads back inside."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, low: float, high: float) -> Tensor:
        ctx.save_for_backward(value)
        ctx.bounds = low, high
        return value.clamp(low, high)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        (value,), (low, high) = ctx.saved_tensors, ctx.bounds
        grad = torch.where(value >= high, grad.clamp_min(0.0), grad)
        return torch.where(value <= low, grad.clamp_max(0.0), grad), None, None


class GaussianHead(nn.Module):
    """Mean from the features; standard deviation fixed, learned, or from the features as well.

    ``scale = clamp(exp(log_std), *std_range)``, where it is learned. At a bound a gradient that
    leads back inside is let through, so that no deviation stays there for good.

    Args:
        size: length of the features.
        joints: number of joints J.
        std: standard deviation (at the start, if learned), in units of the action.
        learn_std: whether the deviation is learned.
        state_std: whether it depends on the features, and so on the state.
        std_range: smallest and largest learned standard deviation.
    """

    keys = ("loc", "scale")
    distribution = IndependentNormal

    log_std: Tensor

    def __init__(
        self,
        size: int,
        joints: int,
        *,
        std: float = 0.5,
        learn_std: bool = True,
        state_std: bool = False,
        std_range: Sequence[float] = (0.02, math.inf),
    ):
        super().__init__()
        self.mean = nn.Linear(size, joints)
        log_std = torch.full((joints,), math.log(std))
        if learn_std:
            self.log_std = nn.Parameter(log_std)
        else:
            self.register_buffer("log_std", log_std)
        self.min_std, self.max_std = std_range if learn_std else (0.0, math.inf)
        self.deviation = nn.Linear(size, joints, bias=False) if state_std else None
        layers = [self.mean] if self.deviation is None else [self.mean, self.deviation]
        for layer in layers:
            nn.init.orthogonal_(layer.weight, 0.01)
        nn.init.zeros_(self.mean.bias)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """``loc`` and ``scale`` ``(*B, J)``."""
        loc, log_std = self.mean(features), self.log_std
        if self.deviation is not None:
            log_std = log_std + self.deviation(features)
        return loc, _Bounded.apply(log_std.exp(), self.min_std, self.max_std).expand_as(loc)

    @torch.no_grad()
    def move_mean(self, offset: Tensor) -> None:
        """Adds ``(J,)`` to the mean, whatever the features."""
        self.mean.bias.add_(offset)


class MixtureHead(nn.Module):
    """Three numbers per component and joint: mean, raw standard deviation, logit.

    ``std = min(softplus(raw) + floor, cap)``, with the ``std_range`` (floor, cap); at the cap a
    gradient that leads back is let through.

    Args:
        size: length of the features.
        joints: number of joints J.
        components: number of Gaussians K per joint.
        std: standard deviation at the start, in units of the action.
        spread: distance between the components' means at the start, for them to tell apart.
        std_range: smallest and largest standard deviation.
    """

    keys = ("logits", "loc", "scale")
    distribution = MixtureOfGaussians

    def __init__(
        self,
        size: int,
        joints: int,
        *,
        components: int = 3,
        std: float = 0.5,
        spread: float = 0.2,
        std_range: Sequence[float] = (0.01, 1.0),
    ):
        super().__init__()
        self.min_std, self.max_std = std_range
        self.shape = (3, joints, components)
        self.linear = nn.Linear(size, 3 * joints * components)
        nn.init.orthogonal_(self.linear.weight, 0.01)
        bias = torch.zeros(self.shape)
        bias[0] = spread * (torch.arange(components) - (components - 1) / 2)
        bias[1] = math.log(math.expm1(std - self.min_std))  # softplus gives the rest
        with torch.no_grad():
            self.linear.bias.copy_(bias.flatten())

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """``logits``, ``loc`` and ``scale`` ``(*B, J, K)``."""
        loc, raw, logits = self.linear(features).unflatten(-1, self.shape).unbind(-3)
        scale = nn.functional.softplus(raw) + self.min_std
        scale = _Bounded.apply(scale, self.min_std, self.max_std)
        return logits, loc, scale

    @torch.no_grad()
    def move_mean(self, offset: Tensor) -> None:
        """Adds ``(J,)`` to the mean of every component, whatever the features."""
        self.linear.bias.view(self.shape)[0].add_(offset[:, None])


class SharedMixtureHead(nn.Module):
    """A logit for each component; a mean and a raw standard deviation for it and every joint.

    ``std = min(softplus(raw) + floor, cap)``, with the ``std_range`` (floor, cap). The means differ
    at the start by random biases: all joints of a component belong together, and no way to act
    comes first.

    Args:
        size: length of the features.
        joints: number of joints J.
        components: number of Gaussians K over all joints.
        std: standard deviation at the start, in units of the action.
        spread: standard deviation of the components' means at the start.
        std_range: smallest and largest standard deviation.
    """

    keys = ("logits", "loc", "scale")
    distribution = SharedMixtureOfGaussians

    def __init__(
        self,
        size: int,
        joints: int,
        *,
        components: int = 3,
        std: float = 0.5,
        spread: float = 0.1,
        std_range: Sequence[float] = (0.01, 1.0),
    ):
        super().__init__()
        self.min_std, self.max_std = std_range
        self.shape = (2, components, joints)
        self.logits = nn.Linear(size, components)
        self.linear = nn.Linear(size, 2 * components * joints)
        bias = torch.zeros(self.shape)
        bias[0] = spread * torch.randn(components, joints)
        bias[1] = math.log(math.expm1(std - self.min_std))  # softplus gives the rest
        for layer in (self.logits, self.linear):
            nn.init.orthogonal_(layer.weight, 0.01)
        with torch.no_grad():
            self.logits.bias.zero_()
            self.linear.bias.copy_(bias.flatten())

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """``logits`` ``(*B, K)``, ``loc`` and ``scale`` ``(*B, K, J)``."""
        loc, raw = self.linear(features).unflatten(-1, self.shape).unbind(-3)
        scale = nn.functional.softplus(raw) + self.min_std
        scale = _Bounded.apply(scale, self.min_std, self.max_std)
        return self.logits(features), loc, scale

    @torch.no_grad()
    def move_mean(self, offset: Tensor) -> None:
        """Adds ``(J,)`` to the mean of every component, whatever the features."""
        self.linear.bias.view(self.shape)[0].add_(offset)


Head = GaussianHead | MixtureHead | SharedMixtureHead


class HeadValues(TypedDict, total=False):
    """What a config may say of a head, see ``make_head``."""

    shared_components: bool
    std: Positive
    learn_std: bool
    state_std: bool
    std_range: Annotated[Sequence[Annotated[float, INFINITE]], ORDERED] | None
    spread: NotNegative | None


def make_head(
    size: int,
    joints: int,
    *,
    components: Whole = 0,
    shared_components: bool = False,
    std: float = 0.5,
    learn_std: bool = True,
    state_std: bool = False,
    std_range: Sequence[float] | None = None,
    spread: float | None = None,
) -> Head:
    """A Gaussian head for no component, else a mixture of so many.

    Raises:
        ValueError: if the deviation of a mixture is to be fixed, or no component to be shared, or
            to have a spread, the deviation is not positive or lies outside of its range, or the
            spread is negative.
    """
    if components < 0:
        raise ValueError(f"components must not be negative, got {components}.")
    if not std > 0:
        raise ValueError(f"std must be positive, got {std}.")
    known: dict[str, Any] = {"std": std}
    if std_range is not None:
        low, high = std_range
        if not 0 < low < high:
            raise ValueError(f"std_range must be [floor, cap], 0 < floor < cap, got {[low, high]}.")
        known["std_range"] = (low, high)
    low, high = known.get("std_range", (0.01, 1.0) if components else (0.02, math.inf))
    if learn_std and not low < std <= high:
        raise ValueError(f"std must lie above the floor {low} and not over {high}, got {std}.")
    if spread is not None:
        if components == 0:
            raise ValueError("spread needs components, got 0 of them.")
        if not spread >= 0:
            raise ValueError(f"spread must not be negative, got {spread}.")
        known["spread"] = spread
    if components == 0:
        if shared_components:
            raise ValueError("shared_components needs components, got 0 of them.")
        if state_std and not learn_std:
            raise ValueError("learn_std must be true with state_std, got false.")
        return GaussianHead(size, joints, learn_std=learn_std, state_std=state_std, **known)
    if not learn_std:
        raise ValueError(f"learn_std must be true with components, got {components} of them.")
    head = SharedMixtureHead if shared_components else MixtureHead
    return head(size, joints, components=components, **known)
