"""Actors: a trunk (MLP or stacked GRU) and a head (Gaussian or mixture of Gaussians)."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.modules import GRUModule, IndependentNormal, ProbabilisticActor

from zfall.modules.mixture import MixtureOfGaussians
from zfall.modules.normalization import ObservationNormalizer

_HIDDEN = "recurrent_state_actor"
_ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}


class GaussianHead(nn.Module):
    """Mean from the features, standard deviation the same in every state, learned or fixed.

    Args:
        size: length of the features.
        joints: number of joints J.
        std: standard deviation (at the start, if learned), in units of the action.
        learn_std: whether the deviation is learned.
        min_std: smallest learned standard deviation.
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
        min_std: float = 0.02,
    ):
        super().__init__()
        self.mean = nn.Linear(size, joints)
        log_std = torch.full((joints,), math.log(std))
        if learn_std:
            self.log_std = nn.Parameter(log_std)
        else:
            self.register_buffer("log_std", log_std)
        self.min_std = min_std if learn_std else 0.0
        nn.init.orthogonal_(self.mean.weight, 0.01)
        nn.init.zeros_(self.mean.bias)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """``loc`` and ``scale`` ``(*B, J)``."""
        loc = self.mean(features)
        return loc, self.log_std.exp().clamp_min(self.min_std).expand_as(loc)


class MixtureHead(nn.Module):
    """Three numbers per component and joint: mean, raw standard deviation, logit.

    ``std = min(softplus(raw) + 0.01, 1)``.

    Args:
        size: length of the features.
        joints: number of joints J.
        components: number of Gaussians K per joint.
        std: standard deviation at the start, in units of the action.
        spread: distance between the components' means at the start, for them to tell apart.
    """

    keys = ("logits", "loc", "scale")
    distribution = MixtureOfGaussians

    def __init__(
        self, size: int, joints: int, *, components: int = 3, std: float = 0.5, spread: float = 0.2
    ):
        super().__init__()
        self.shape = (3, joints, components)
        self.linear = nn.Linear(size, 3 * joints * components)
        nn.init.orthogonal_(self.linear.weight, 0.01)
        bias = torch.zeros(self.shape)
        bias[0] = spread * (torch.arange(components) - (components - 1) / 2)
        bias[1] = math.log(math.expm1(std - 0.01))  # softplus gives std - 0.01
        with torch.no_grad():
            self.linear.bias.copy_(bias.flatten())

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """``logits``, ``loc`` and ``scale`` ``(*B, J, K)``."""
        loc, raw, logits = self.linear(features).unflatten(-1, self.shape).unbind(-3)
        scale = (nn.functional.softplus(raw) + 0.01).clamp_max(1.0)
        return logits, loc, scale


def make_head(
    size: int, joints: int, components: int, std: float, learn_std: bool = True
) -> GaussianHead | MixtureHead:
    """A Gaussian head for no component, else a mixture of so many.

    Raises:
        ValueError: if the deviation of a mixture is to be fixed.
    """
    if components == 0:
        return GaussianHead(size, joints, std=std, learn_std=learn_std)
    if not learn_std:
        raise ValueError(f"learn_std must be true with components, got {components} of them.")
    return MixtureHead(size, joints, components=components, std=std)


def mlp_trunk(size: int, num_cells: Sequence[int], activation: str = "elu") -> nn.Sequential:
    """Linear layers with an activation behind each, initialised orthogonally.

    Raises:
        ValueError: on an unknown activation.
    """
    if activation not in _ACTIVATIONS:
        names = ", ".join(_ACTIVATIONS)
        raise ValueError(f"activation must be one of {names}, got {activation!r}.")
    layers: list[nn.Module] = []
    for cells in num_cells:
        linear = nn.Linear(size, cells)
        nn.init.orthogonal_(linear.weight, math.sqrt(2))
        nn.init.zeros_(linear.bias)
        layers += [linear, _ACTIVATIONS[activation]()]
        size = cells
    return nn.Sequential(*layers)


def normalizer(size: int, normalize: bool) -> list[nn.Module]:
    """What stands before the first layer: a normaliser, or nothing."""
    return [ObservationNormalizer(size)] if normalize else []


def mlp_actor(
    observation_spec: Composite,
    action_spec: Composite,
    *,
    num_cells: Sequence[int] = (128, 128),
    activation: str = "elu",
    components: int = 0,
    std: float = 0.5,
    learn_std: bool = True,
    normalize: bool = True,
    statistic: str = "mean",
) -> ProbabilisticActor:
    """Feed-forward actor: ``observation`` ``(*B, D)`` -> ``action`` ``(*B, J)``.

    Args:
        observation_spec, action_spec: of the env.
        num_cells: widths of the hidden layers.
        activation: behind each of them: ``elu``, ``relu`` or ``tanh``.
        components: Gaussians per joint; 0 for a plain Gaussian, its deviation the same everywhere.
        std: standard deviation at the start, in units of the action.
        learn_std: whether a plain Gaussian's deviation is learned.
        normalize: whether observations are centered and scaled by their statistics so far.
        statistic: what the policy does when it does not explore, ``mean`` or ``mode``.

    Raises:
        ValueError: on another statistic or activation, or a mixture of fixed deviation.
    """
    size, joints = observation_spec["observation"].shape[-1], action_spec.shape[-1]
    head = make_head(num_cells[-1], joints, components, std, learn_std)
    trunk = mlp_trunk(size, num_cells, activation)
    net = nn.Sequential(*normalizer(size, normalize), trunk, head)
    module = TensorDictModule(net, in_keys=["observation"], out_keys=list(head.keys))
    return _actor(module, head, statistic)


def gru_actor(
    observation_spec: Composite,
    action_spec: Composite,
    *,
    hidden_size: int = 64,
    num_layers: int = 3,
    components: int = 3,
    std: float = 0.5,
    normalize: bool = True,
    statistic: str = "mean",
) -> ProbabilisticActor:
    """Recurrent actor: a linear layer, stacked GRU cells, a head.

    Reads ``observation`` ``(*B, D)``, ``is_init`` and its own hidden state under
    ``recurrent_state_actor`` ``(*B, num_layers, hidden_size)``, whose successor it writes under
    ``("next", "recurrent_state_actor")``; writes ``action`` ``(*B, J)``.

    Args:
        observation_spec, action_spec: of the env.
        hidden_size: width of the GRU layers.
        num_layers: number of GRU layers.
        components: Gaussians per joint; 0 for a plain Gaussian with a learned deviation.
        std: standard deviation at the start, in units of the action.
        normalize: whether observations are centered and scaled by their statistics so far.
        statistic: what the policy does when it does not explore, ``mean`` or ``mode``.

    Raises:
        ValueError: on another statistic.
    """
    size, joints = observation_spec["observation"].shape[-1], action_spec.shape[-1]
    head = make_head(hidden_size, joints, components, std)
    encoder = nn.Sequential(*normalizer(size, normalize), nn.Linear(size, hidden_size))
    module = TensorDictSequential(
        TensorDictModule(encoder, in_keys=["observation"], out_keys=["embedding_actor"]),
        gru(hidden_size, num_layers, "embedding_actor", "features_actor", _HIDDEN),
        TensorDictModule(head, in_keys=["features_actor"], out_keys=list(head.keys)),
    )
    return _actor(module, head, statistic)


def gru(size: int, num_layers: int, in_key: str, out_key: str, hidden: str) -> GRUModule:
    """Stacked GRU cells whose hidden state travels in the TensorDict."""
    return GRUModule(
        input_size=size,
        hidden_size=size,
        num_layers=num_layers,
        in_keys=[in_key, hidden, "is_init"],
        out_keys=[out_key, ("next", hidden)],
    )


def _actor(
    module: TensorDictModule, head: GaussianHead | MixtureHead, statistic: str
) -> ProbabilisticActor:
    if statistic not in ("mean", "mode"):
        raise ValueError(f"statistic must be mean or mode, got {statistic!r}.")
    mixture = isinstance(head, MixtureHead)
    actor = ProbabilisticActor(
        module,
        in_keys=list(head.keys),
        out_keys=["action"],
        distribution_class=head.distribution,
        distribution_kwargs={"statistic": statistic}
        if mixture
        else {},  # of a Gaussian both are one
        return_log_prob=True,
    )
    kept = ["action", "action_log_prob"]
    recurrent = [key for key in module.out_keys if isinstance(key, tuple)]
    actor.select_out_keys(*kept, *recurrent)  # the rest need not be stored
    return actor


def normalizer_of(module: nn.Module) -> ObservationNormalizer | None:
    """The observation normaliser inside an actor or a critic, if it has one."""
    parts = (part for part in module.modules() if isinstance(part, ObservationNormalizer))
    return next(parts, None)


def recurrent_keys(module: nn.Module) -> list[str]:
    """Names of the hidden states that an actor or a critic carries from step to step."""
    keys: Any = module.in_keys
    return [key for key in keys if str(key).startswith("recurrent_state")]
