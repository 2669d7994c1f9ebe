"""Trunks: what networks are made of in front of their heads."""

import math
from collections.abc import Sequence
from typing import Annotated

import torch
from tensordict.nn import TensorDictModule
from torch import nn

from zfall.modules.gru import StackedGRU
from zfall.modules.normalization import ObservationNormalizer
from zfall.modules.symmetric import Handed
from zfall.values import Rule, one_of

_ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}
Activation = Annotated[str, one_of(*_ACTIVATIONS)]
Initialization = Annotated[str, one_of("orthogonal", "default")]
MemorySteps = Annotated[float, Rule("be at least 2 and finite", lambda x: 2 <= x < math.inf)]


def front(
    size: int, normalize: bool | str | ObservationNormalizer, handedness: float | None = None
) -> tuple[list[nn.Module], int]:
    """What stands before the first layer, and the width of what it gives.

    Args:
        size: of the observation.
        normalize: see ``normalizer``.
        handedness: of a symmetric network, see ``Handed``; ``None``: it has no such input.
    """
    modules = normalizer(size, normalize)
    return (modules, size) if handedness is None else ([*modules, Handed(handedness)], size + 1)


def mlp_trunk(
    size: int,
    num_cells: Sequence[int],
    activation: str = "elu",
    initialization: str = "orthogonal",
) -> nn.Sequential:
    """Linear layers with an activation behind each.

    Weights are drawn layer by layer: ``orthogonal`` of gain sqrt(2) with biases of zero, or as
    torch does by itself, ``default``.

    Raises:
        ValueError: on an unknown activation or initialization, or no layer or cell.
    """
    _check_initialization(initialization)
    check_widths(num_cells)
    if activation not in _ACTIVATIONS:
        names = ", ".join(_ACTIVATIONS)
        raise ValueError(f"activation must be one of {names}, got {activation!r}.")
    layers: list[nn.Module] = []
    for cells in num_cells:
        linear = nn.Linear(size, cells)
        if initialization == "orthogonal":
            nn.init.orthogonal_(linear.weight, math.sqrt(2))
            nn.init.zeros_(linear.bias)
        layers += [linear, _ACTIVATIONS[activation]()]
        size = cells
    return nn.Sequential(*layers)


def gru_trunk(
    size: int,
    hidden_size: int,
    num_layers: int,
    normalize: bool | str | ObservationNormalizer,
    initialization: str,
    *,
    role: str,
    in_key: str,
    encoder_cells: Sequence[int] = (),
    activation: str = "elu",
    memory_steps: float | None = None,
    handedness: float | None = None,
) -> tuple[TensorDictModule, StackedGRU]:
    """A linear layer and stacked GRU cells: ``in_key`` ``(*B, size)`` -> ``features_ROLE``.

    In front of the linear layer there may be an ``mlp_trunk`` of ``encoder_cells``. Weights are
    drawn layer by layer: ``orthogonal``, those of each gate by themselves, with biases of zero, or
    as torch does by itself, ``default``. The hidden state is ``recurrent_state_ROLE``.

    Of what a cell remembers, a GRU keeps about half in each step at the start, and the gradient
    through many steps vanishes. With ``memory_steps`` T the biases of the gates that keep are
    log(u), u uniform from 1 to T - 1, so that cells remember for 2 to T steps.

    Raises:
        ValueError: on an unknown initialization, no layer or cell, or fewer than 2 steps.

    Source of these biases: Tallec and Ollivier, "Can recurrent neural networks warp time?",
    ICLR 2018.
    """
    _check_initialization(initialization)
    if memory_steps is not None and not 2 <= memory_steps < math.inf:
        raise ValueError(f"memory_steps must be at least 2 and finite, got {memory_steps}.")
    for name, value in (("hidden_size", hidden_size), ("num_layers", num_layers)):
        if value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}.")
    first, size = front(size, normalize, handedness)
    if encoder_cells:
        first.append(mlp_trunk(size, encoder_cells, activation, initialization))
    linear = nn.Linear(encoder_cells[-1] if encoder_cells else size, hidden_size)
    embedding, features, hidden = f"embedding_{role}", f"features_{role}", hidden_key(role)
    gru = StackedGRU(hidden_size, num_layers, embedding, features, hidden)
    if initialization == "orthogonal":
        for name, values in [*linear.named_parameters(), *gru.named_parameters()]:
            if "bias" in name:
                nn.init.zeros_(values)
            else:
                for gate in values.split(hidden_size):
                    nn.init.orthogonal_(gate)
    if memory_steps is not None:
        for name, values in gru.named_parameters():
            if "bias" in name:
                keeps = values.data[hidden_size : 2 * hidden_size]
                both = torch.empty_like(keeps).uniform_(1.0, memory_steps - 1.0).log()
                keeps.copy_(both if "bias_ih" in name else torch.zeros_like(keeps))
    encoder = nn.Sequential(*first, linear)
    return TensorDictModule(encoder, in_keys=[in_key], out_keys=[embedding]), gru


def hidden_key(role: str) -> str:
    """Name of the hidden state of an ``actor`` or a ``critic``."""
    return f"recurrent_state_{role}"


def check_handedness(symmetric: bool, handedness: float | None) -> None:
    """Refuses the input of one side where there is no other."""
    if handedness is not None and not symmetric:
        raise ValueError(f"handedness must be null unless symmetric is true, got {handedness}.")
    if handedness is not None and not math.isfinite(handedness):
        raise ValueError(f"handedness must be finite, got {handedness}.")


def check_widths(num_cells: Sequence[int]) -> None:
    if not num_cells or min(num_cells) < 1:
        raise ValueError(f"num_cells must be widths of at least 1, one or more, got {num_cells}.")


def _check_initialization(initialization: str) -> None:
    if initialization not in ("orthogonal", "default"):
        raise ValueError(f"initialization must be orthogonal or default, got {initialization!r}.")


def normalizer(size: int, normalize: bool | str | ObservationNormalizer) -> list[nn.Module]:
    """What stands before the first layer: a normaliser, new or shared, or nothing.

    Raises:
        ValueError: if the one to be shared is of another size, or if it is a word.
    """
    if isinstance(normalize, str):
        raise ValueError(
            f"normalize must be true or false, of a critic also shared, got {normalize}."
        )
    if isinstance(normalize, ObservationNormalizer):
        if len(normalize.mean) != size:
            raise ValueError(
                f"a shared normaliser must have the size of the observation, {size}, "
                f"got {len(normalize.mean)}."
            )
        return [normalize]
    return [ObservationNormalizer(size)] if normalize else []
