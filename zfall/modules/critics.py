"""Critics: the value of a state, from what the simulator knows."""

import math
from collections.abc import Sequence
from typing import Literal

from tensordict.nn import TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.modules import ValueOperator

from zfall.modules.normalization import ObservationNormalizer
from zfall.modules.symmetric import SymmetricValue
from zfall.modules.trunks import (
    Activation,
    Initialization,
    check_handedness,
    front,
    gru_trunk,
    hidden_key,
    mlp_trunk,
)
from zfall.values import Count, Positive


class ValueHead(nn.Linear):
    """A linear layer whose single output is in units of ``scale``.

    Returns of hundreds would otherwise have to grow out of weights that an optimizer moves by
    its learning rate per step.

    Args:
        size: length of the features.
        scale: what an output of 1 is worth.
    """

    def __init__(self, size: int, scale: float):
        super().__init__(size, 1)
        if not 0 < scale < math.inf:
            raise ValueError(f"scale must be positive and finite, got {scale}.")
        self.scale = scale

    def forward(self, features: Tensor) -> Tensor:
        """Values ``(*B, 1)``."""
        return self.scale * super().forward(features)


def _observation_size(observation_spec: Composite) -> int:
    """Length of what a critic sees."""
    if "observation_critic" not in observation_spec.keys():
        raise ValueError(
            "the env must bring observation_critic, as an ObservationVector with that out_key does."
        )
    return int(observation_spec["observation_critic"].shape[-1])


def mlp_critic(
    observation_spec: Composite,
    *,
    num_cells: Sequence[Count] = (128, 128),
    activation: Activation = "elu",
    initialization: Initialization = "orthogonal",
    normalize: bool | Literal["shared"] | ObservationNormalizer = True,
    symmetric: bool = False,
    handedness: float | None = None,
    scale: Positive = 1.0,
) -> ValueOperator:
    """Feed-forward critic: ``observation_critic`` ``(*B, D)`` -> ``state_value`` ``(*B, 1)``.

    Args:
        observation_spec: of the env.
        num_cells: widths of the hidden layers.
        activation: behind each of them: ``elu``, ``relu`` or ``tanh``.
        initialization: of these layers, see ``mlp_trunk``.
        normalize: whether observations are centered and scaled by their statistics so far; or
            the normaliser of an actor that sees the same, to be shared.
        symmetric: whether a state and its mirror image have the same value.
        handedness: as of an actor: with it, they may differ.
        scale: unit of the values.

    Raises:
        ValueError: if the env has no such observation.
    """
    size = _observation_size(observation_spec)
    check_handedness(symmetric, handedness)
    first, width = front(size, normalize, handedness)
    trunk = mlp_trunk(width, num_cells, activation, initialization)
    net: nn.Module = nn.Sequential(*first, trunk, ValueHead(num_cells[-1], scale))
    if symmetric:
        net = SymmetricValue(net, size)
    return ValueOperator(net, in_keys=["observation_critic"])


def gru_critic(
    observation_spec: Composite,
    *,
    hidden_size: Count = 64,
    num_layers: Count = 3,
    initialization: Initialization = "default",
    normalize: bool | Literal["shared"] | ObservationNormalizer = True,
    scale: Positive = 1.0,
) -> TensorDictSequential:
    """Recurrent critic: a linear layer, stacked GRU cells, a linear layer.

    Keys as ``mlp_critic``; also reads ``is_init`` and its own hidden state under
    ``recurrent_state_critic`` ``(*B, num_layers, hidden_size)``, whose successor it writes under
    ``("next", "recurrent_state_critic")``.

    Args:
        observation_spec: of the env.
        hidden_size: width of the GRU layers.
        num_layers: number of GRU layers.
        initialization: of these layers, see ``gru_trunk``.
        normalize: whether observations are centered and scaled by their statistics so far; or
            the normaliser of an actor that sees the same, to be shared.
        scale: unit of the values.

    Raises:
        ValueError: if the env has no such observation.
    """
    size = _observation_size(observation_spec)
    critic = TensorDictSequential(
        *gru_trunk(
            size,
            hidden_size,
            num_layers,
            normalize,
            initialization,
            role="critic",
            in_key="observation_critic",
        ),
        ValueOperator(ValueHead(hidden_size, scale), in_keys=["features_critic"]),
    )
    critic.select_out_keys(
        "state_value", ("next", hidden_key("critic"))
    )  # the rest need not be stored
    return critic
