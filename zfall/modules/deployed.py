"""A policy without TensorDicts, noise or exploration, as it runs on a robot."""

from collections.abc import Callable
from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import GRUModule, IndependentNormal, LSTMModule

from zfall.modules.actors import recurrent_keys
from zfall.modules.memory import memory_beginning, parts_of


class DeployedPolicy(nn.Module):
    """``observation`` ``(B, D)`` and memories -> ``action`` ``(B, J)`` and the next memories.

    The modules of the actor one after the other, each on plain tensors. A memory ``(B, ...)`` is
    that of one robot, as it is stored in a batch.

    Args:
        actor: of ``TensorDictModule``, TorchRL's ``GRUModule`` and ``LSTMModule``, which sees
            ``observation`` alone.

    Raises:
        ValueError: on another one.
    """

    def __init__(self, actor: Any):
        super().__init__()
        self.memory = recurrent_keys(actor)
        seen = [key for key in actor.in_keys if key not in (*self.memory, "is_init")]
        if seen != ["observation"]:
            raise ValueError(
                "run must have a policy that sees the observation alone to be exported, got "
                f"{', '.join(map(str, seen))}."
            )
        *parts, _ = parts_of(actor)
        self.parts = [_plain(part) for part in parts]
        self.modules_of_parts = nn.ModuleList(p for p in self.parts if isinstance(p, nn.Module))
        self.reads = [[key for key in part.in_keys if key != "is_init"] for part in parts]
        self.writes = [list(part.out_keys) for part in parts]
        self.statistic = _Statistic(actor)

    def forward(self, observation: Tensor, *memories: Tensor) -> Tensor | tuple[Tensor, ...]:
        """The action without exploration, and the next memories if there are any."""
        known: dict[NestedKey, Tensor] = dict(zip(self.memory, memories, strict=True))
        known["observation"] = observation
        for part, reads, writes in zip(self.parts, self.reads, self.writes, strict=True):
            out = part(*(known[key] for key in reads))
            known |= zip(writes, out if isinstance(out, tuple) else (out,), strict=True)
        action = self.statistic(known)
        return (action, *(known["next", key] for key in self.memory)) if memories else action


class _GRUStep(nn.Module):
    """One step of a ``GRUModule`` from one in which no episode begins."""

    def __init__(self, module: GRUModule):
        super().__init__()
        self.gru = module.gru

    def forward(self, value: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        features, after = self.gru(value[:, None], memory.transpose(0, 1).contiguous())
        return features[:, 0], after.transpose(0, 1)


class _LSTMStep(nn.Module):
    """One step of an ``LSTMModule`` from one in which no episode begins."""

    def __init__(self, module: LSTMModule):
        super().__init__()
        self.lstm = module.lstm

    def forward(self, value: Tensor, memory: Tensor, cell: Tensor) -> tuple[Tensor, ...]:
        before = tuple(x.transpose(0, 1).contiguous() for x in (memory, cell))
        features, after = self.lstm(value[:, None], before)
        return features[:, 0], *(x.transpose(0, 1) for x in after)


def _plain(part: Any) -> Callable[..., Any]:
    if isinstance(part, GRUModule):
        return _GRUStep(part)
    if isinstance(part, LSTMModule):
        return _LSTMStep(part)
    if isinstance(part, TensorDictModule) and "is_init" not in part.in_keys:
        function: Callable[..., Any] = part.module
        return function
    raise ValueError(
        "run must have a policy of TensorDictModule, GRUModule and LSTMModule to be exported, got "
        f"{type(part).__name__}."
    )


class _Statistic(nn.Module):
    """From a distribution's parameters to its mean or mode, whichever the policy was kept with."""

    def __init__(self, actor: Any):
        super().__init__()
        self.distribution = actor[-1].distribution_class
        self.given = dict(actor[-1].distribution_kwargs)
        self.keys = dict(zip(actor[-1].dist_keys, actor[-1].in_keys, strict=True))

    def forward(self, known: dict[NestedKey, Tensor]) -> Tensor:
        named = {name: known[key] for name, key in self.keys.items()}
        if issubclass(self.distribution, IndependentNormal):
            return named["loc"]  # of a Gaussian mean and mode are one
        out: Tensor = self.distribution(**named, **self.given).deterministic_sample
        return out


def deployed(actor: Any) -> nn.Module:
    """The policy of an actor.

    Args:
        actor: any that ``DeployedPolicy`` takes, or one of a class that declares ``not_deployed``.

    Raises:
        ValueError: if it has no plain form, with the text of ``not_deployed``.
    """
    if reason := getattr(actor, "not_deployed", None):
        raise ValueError(reason)
    return DeployedPolicy(actor).eval()


def memories_at_start(actor: Any) -> dict[str, Tensor]:
    """The memories ``(1, ...)`` of a policy at the start, by the names that they are exported with.

    The only one is ``memory``, of several each has the name of its hidden state.

    Raises:
        ValueError: if one does not begin with one number.
    """
    begins = memory_beginning(actor) if recurrent_keys(actor) else {}
    starts = {
        key if isinstance(key, str) else "/".join(key): torch.full((1, *spec.shape), value)
        for key, (spec, value) in begins.items()
    }
    return dict(zip(["memory"], starts.values(), strict=True)) if len(starts) == 1 else starts
