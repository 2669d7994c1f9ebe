"""Critics: the value of a state, from what the simulator knows."""

from collections.abc import Sequence

from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Composite
from torchrl.modules import ValueOperator

from zfall.modules.actors import gru, mlp_trunk
from zfall.modules.normalization import ObservationNormalizer


def mlp_critic(
    observation_spec: Composite, *, num_cells: Sequence[int] = (128, 128)
) -> ValueOperator:
    """Feed-forward critic: ``observation_critic`` ``(*B, D)`` -> ``state_value`` ``(*B, 1)``.

    Args:
        observation_spec: of the env.
        num_cells: widths of the hidden layers.
    """
    size = observation_spec["observation_critic"].shape[-1]
    net = nn.Sequential(
        ObservationNormalizer(size), mlp_trunk(size, num_cells), nn.Linear(num_cells[-1], 1)
    )
    return ValueOperator(net, in_keys=["observation_critic"])


def gru_critic(
    observation_spec: Composite, *, hidden_size: int = 64, num_layers: int = 3
) -> TensorDictSequential:
    """Recurrent critic: a linear layer, stacked GRU cells, a linear layer.

    Keys as ``mlp_critic``, with a hidden state of its own under ``recurrent_state_critic``.

    Args:
        observation_spec: of the env.
        hidden_size: width of the GRU layers.
        num_layers: number of GRU layers.
    """
    size = observation_spec["observation_critic"].shape[-1]
    encoder = nn.Sequential(ObservationNormalizer(size), nn.Linear(size, hidden_size))
    return TensorDictSequential(
        TensorDictModule(encoder, in_keys=["observation_critic"], out_keys=["embedding_critic"]),
        gru(hidden_size, num_layers, "embedding_critic", "features", "recurrent_state_critic"),
        ValueOperator(nn.Linear(hidden_size, 1), in_keys=["features"]),
    )
