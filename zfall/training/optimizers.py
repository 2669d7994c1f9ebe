"""The optimizer of a training and its learning rate."""

import inspect
import math
from collections.abc import Iterable, Mapping
from typing import Any

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig
from torch import Tensor
from torchrl.objectives import KLAdaptiveLR

from zfall.errors import named, object_at
from zfall.static_checks import parameters_of
from zfall.values import Positive

FOLLOWED = ("kl", "metrics")  # what a scheduler's step may take, see follow


def build_optimizer(
    cfg: DictConfig, parameters: list[torch.nn.Parameter]
) -> tuple[torch.optim.Optimizer, Any]:
    """The optimizer, and the scheduler of its learning rate or ``None``.

    Args:
        cfg: of the training. ``optimizer`` names what makes an optimizer of the list of
            parameters; it may divide them into groups. ``scheduler`` names what makes a scheduler
            of that, see ``follow``.
        parameters: the actor's, then the critic's.

    Raises:
        ValueError: on a value that one of them refuses, another thing than an optimizer, or a
            scheduler that cannot be saved or whose ``step`` takes what nobody knows.
    """
    with named("optimizer"):
        optimizer = instantiate(without_fused(cfg.optimizer), parameters)
    if not isinstance(optimizer, torch.optim.Optimizer):
        raise ValueError(
            "optimizer._target_ must make a torch.optim.Optimizer of the parameters, "
            f"{cfg.optimizer._target_} makes a {type(optimizer).__name__}."
        )
    if not cfg.scheduler:
        return optimizer, None
    with named("scheduler"):
        scheduler = instantiate(cfg.scheduler, optimizer)
    if missing := [
        n for n in ("step", "load_state_dict", "state_dict") if not hasattr(scheduler, n)
    ]:
        raise ValueError(
            f"scheduler must have step, state_dict and load_state_dict, {cfg.scheduler._target_} "
            f"has no {missing[0]}."
        )
    taken = inspect.signature(scheduler.step).parameters.values()
    for value in taken:
        required = value.default is value.empty and value.kind is not value.VAR_KEYWORD
        if required and value.name not in FOLLOWED:
            raise ValueError(
                f"scheduler.step must take kl, metrics or nothing, that of "
                f"{cfg.scheduler._target_} takes {value.name}."
            )
    return optimizer, scheduler


def without_fused(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table of an optimizer; ``fused`` is Adam's, from ``train.yaml``, and not all take it.

    Raises:
        ValueError: on a ``_target_`` that is not there.
    """
    values = dict(table)
    target = values.get("_target_")
    if "fused" in values and isinstance(target, str) and target.strip():
        known = parameters_of(object_at(target, "optimizer._target_"))
        if not {"fused", "**"} & known.keys():
            del values["fused"]
    return values


def follow(scheduler: Any, reward: float, divergence: float | None) -> None:
    """Lets a scheduler, if there is one, take its step after an update.

    Its ``step`` gets by name what it takes: ``kl``, the divergence of the update, as that of
    ``torchrl.objectives.KLAdaptiveLR`` does; ``metrics``, the mean reward, as that of
    ``ReduceLROnPlateau`` does. All others of ``torch.optim.lr_scheduler`` take none.

    Args:
        scheduler: or ``None``.
        reward: mean over the batch.
        divergence: of the update; ``None`` if it is not known. What follows it then takes no step.
    """
    if scheduler is None:
        return
    figures = {"metrics": reward}
    if divergence is not None:
        figures["kl"] = max(divergence, 1e-6)  # 0 would leave a rate where nothing moves
    taken = [name for name in inspect.signature(scheduler.step).parameters if name in FOLLOWED]
    if all(name in figures for name in taken):
        scheduler.step(**{name: figures[name] for name in taken})


def learning_rates(optimizer: torch.optim.Optimizer) -> dict[str, float]:
    """``learning_rate`` of the first group of parameters; ``learning_rate/1`` of the next ..."""
    rates = [float(group["lr"]) for group in optimizer.param_groups]
    return {f"learning_rate/{n}" if n else "learning_rate": rate for n, rate in enumerate(rates)}


class KLProportionalLR(KLAdaptiveLR):
    """Brings the divergence of each update to its target, where ``KLAdaptiveLR`` leaves a band.

    After each update the learning rate is multiplied by ``(target_kl / kl)^gain``, by at most
    ``factor`` either way. The divergence goes with the square of the learning rate, so that a
    gain of 0.5 would correct all of an error at once; less of it follows the noise less.

    Args:
        optimizer: whose groups all get the new rate in proportion.
        target_kl: mean divergence of an update.
        gain: share of an error, in logarithms, that is corrected after an update.
        factor: largest change of the rate after an update.
        min_lr, max_lr: bounds of the rate.

    Raises:
        ValueError: on a value out of its range.
    """

    def __init__(
        self,
        optimizer: torch.optim.Optimizer,
        target_kl: Positive,
        *,
        gain: Positive = 0.2,
        factor: float = 1.5,
        min_lr: Positive = 1e-5,
        max_lr: Positive = 1e-2,
    ):
        super().__init__(optimizer, target_kl, factor=factor, min_lr=min_lr, max_lr=max_lr)
        if not 0 < gain <= 1:
            raise ValueError(f"gain must be above 0 and at most 1, got {gain}.")
        self.gain = gain

    def step(self, kl: float | Tensor) -> None:
        """Changes the rates by the divergence of an update; one of 0 changes nothing."""
        found = float(kl)
        if not math.isfinite(found):
            raise ValueError(f"kl must be finite, got {found}.")
        change = (self.target_kl / found) ** self.gain if found > 0 else 1.0
        change = min(max(change, 1 / self.factor), self.factor)
        for group in self.optimizer.param_groups:
            group["lr"] = min(max(group["lr"] * change, self.min_lr), self.max_lr)
        self.last_kl = found


class MuonAndAdam(torch.optim.Optimizer):
    """Muon for matrices, Adam for all other parameters, in groups of their own.

    Muon's steps have the size of Adam's, so one learning rate goes for both.

    Args:
        parameters: at least one matrix and one that is none.
        lr: learning rate.
        momentum: Muon's.
        weight_decay: factor of both, decoupled.
        betas: Adam's.

    Raises:
        ValueError: if one of the two kinds is missing.

    Source: Jordan et al., "Muon: an optimizer for hidden layers in neural networks", 2024; scaled
    as in Liu et al., "Muon is scalable for LLM training", 2025. Here also the first and last
    layers are Muon's.
    """

    def __init__(
        self,
        parameters: Iterable[Tensor],
        *,
        lr: float = 5.0e-4,
        momentum: float = 0.95,
        weight_decay: float = 0.0,
        betas: tuple[float, float] = (0.9, 0.999),
    ):
        kinds: dict[bool, list[Tensor]] = {True: [], False: []}
        for parameter in parameters:
            kinds[parameter.ndim == 2].append(parameter)
        if not all(kinds.values()):
            raise ValueError("MuonAndAdam must have both matrices and other parameters to train.")
        shared: dict[str, Any] = {"lr": lr, "weight_decay": weight_decay}
        own: dict[str, Any] = {"momentum": momentum, "adjust_lr_fn": "match_rms_adamw"}
        self._parts: list[torch.optim.Optimizer] = [
            torch.optim.Muon(kinds[True], **shared, **own),
            torch.optim.AdamW(kinds[False], betas=betas, **shared),
        ]
        super().__init__(self._groups(), {})

    def _groups(self) -> list[dict[str, Any]]:
        return [group for part in self._parts for group in part.param_groups]

    @torch.no_grad()
    def step(self, closure: Any = None) -> None:  # type: ignore[override]
        """One step of both."""
        for part in self._parts:
            part.step()

    def state_dict(self) -> dict[str, Any]:
        """That of both, Muon's first."""
        return {"parts": [part.state_dict() for part in self._parts]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from what ``state_dict`` gave."""
        for part, state in zip(self._parts, state_dict["parts"], strict=True):
            part.load_state_dict(state)
        self.param_groups = self._groups()  # which the two have made anew
