"""A policy without TensorDicts, noise or exploration, as it runs on a robot."""

from typing import Any

import torch
from torch import Tensor, nn

from zfall.modules.actors import recurrent_keys


class DeployedMLP(nn.Module):
    """``observation`` ``(B, D)`` -> ``action`` ``(B, J)``: normaliser, network, statistic.

    Args:
        actor: of ``mlp_actor``.
    """

    def __init__(self, actor: Any):
        super().__init__()
        self.network = actor[0].module
        self.statistic = _Statistic(actor)

    def forward(self, observation: Tensor) -> Tensor:
        """The action without exploration."""
        return self.statistic(self.network(observation))


class DeployedGRU(nn.Module):
    """``observation`` and ``memory`` ``(B, L, H)`` -> ``action`` and the next memory.

    The memory is zero at the start.

    Args:
        actor: of ``gru_actor``.
    """

    def __init__(self, actor: Any):
        super().__init__()
        encoder, memory, *added, head = actor[0]
        self.encoder, self.head = encoder.module, head.module
        self.gru, self.residual = memory.gru, len(added) == 1
        self.statistic = _Statistic(actor)

    def forward(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """The action without exploration, and the next memory."""
        before = memory.transpose(0, 1).contiguous()
        embedding = self.encoder(observation)
        features, after = self.gru(embedding[:, None], before)
        features = features[:, 0] + embedding if self.residual else features[:, 0]
        return self.statistic(self.head(features)), after.transpose(0, 1)


class _Statistic(nn.Module):
    """From a distribution's parameters to its mean or mode, whichever the policy was kept with."""

    def __init__(self, actor: Any):
        super().__init__()
        self.distribution = actor[-1].distribution_class
        self.given = dict(actor[-1].distribution_kwargs)
        self.keys = list(actor[-1].in_keys)

    def forward(self, parameters: tuple[Tensor, ...]) -> Tensor:
        named = dict(zip(self.keys, parameters, strict=True))
        if list(named) == ["loc", "scale"] and not self.given.get("statistic"):
            return named["loc"]  # of a Gaussian mean and mode are one
        out: Tensor = self.distribution(**named, **self.given).deterministic_sample
        return out


def deployed(actor: Any) -> nn.Module:
    """The policy of an actor.

    Args:
        actor: of ``mlp_actor`` or ``gru_actor``, or one of a class that declares ``not_deployed``.

    Raises:
        ValueError: if it has no plain form, with the text of ``not_deployed``.
    """
    if reason := getattr(actor, "not_deployed", None):
        raise ValueError(reason)
    module = DeployedGRU(actor) if recurrent_keys(actor) else DeployedMLP(actor)
    return module.eval()


def memory_shape(actor: Any) -> tuple[int, int] | None:
    """Layers and width of a policy's memory, if it has one."""
    if not recurrent_keys(actor):
        return None
    gru = DeployedGRU(actor).gru
    return int(gru.num_layers), int(gru.hidden_size)


def zero_memory(actor: Any) -> Tensor | None:
    """The memory ``(1, L, H)`` at the start."""
    shape = memory_shape(actor)
    return None if shape is None else torch.zeros(1, *shape)
