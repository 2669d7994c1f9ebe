"""A small recurrent network that predicts falls."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from zfall import checkpoint
from zfall.falling.files import ASSETS
from zfall.fingerprints import reads_files
from zfall.modules.normalization import ObservationNormalizer
from zfall.robots import DEFAULT

SEEN = ("projected_gravity", "base_angular_velocity", "joint_position", "joint_velocity", "target")
_KINDS = {"sizes": Mapping, "fall_network": Mapping}
SHIPPED = {"keys": [*SEEN], "control_dt": 0.04}  # with which the default network was trained


class FallNetwork(nn.Module):
    """Probability that a fall can no longer be avoided, from a sequence of measurements.

    A GRU reads normalised measurements; a linear layer gives the logit, which a calibration scales:
    ``p = sigmoid(slope * logit + offset)``.

    Attributes:
        trained_with: ``keys``, the names of the measurements in order, and ``control_dt`` [s].

    Args:
        size: length of the measurements.
        hidden_size: of the GRU.
    """

    slope: Tensor
    offset: Tensor
    trained_with: dict[str, Any] | None = None

    def __init__(self, size: int, hidden_size: int = 32):
        super().__init__()
        self.normalizer = ObservationNormalizer(size)
        self.gru = nn.GRU(size, hidden_size, batch_first=True)
        self.out = nn.Linear(hidden_size, 1)
        self.register_buffer("slope", torch.ones(()))
        self.register_buffer("offset", torch.zeros(()))

    @property
    def hidden_size(self) -> int:
        """Length of the memory H."""
        return self.gru.hidden_size

    def logits(self, sequence: Tensor, memory: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Raw logits ``(N, T)`` of sequences ``(N, T, D)``, and the memory after ``(N, H)``."""
        before = None if memory is None else memory[None].contiguous()
        features, after = self.gru(self.normalizer(sequence), before)
        return self.out(features).squeeze(-1), after[0]

    def forward(self, measurement: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Calibrated probability ``(N, 1)`` after one step ``(N, D)``, and the new memory."""
        logit, after = self.logits(measurement[:, None], memory)
        return torch.sigmoid(self.slope * logit + self.offset), after


def fall_network_path(path: str | None) -> Path:
    """The file of a name or path, see ``load_fall_network``."""
    shipped = ASSETS / (path or f"{DEFAULT.name}_fall_network.pt")
    return (
        shipped if path is None or (shipped.is_file() and not Path(path).exists()) else Path(path)
    )


def save_fall_network(network: FallNetwork, path: Path) -> None:
    """Writes the weights, the sizes, and ``trained_with``."""
    sizes = {"size": network.gru.input_size, "hidden_size": network.hidden_size}
    content = {"sizes": sizes, "trained_with": network.trained_with}
    checkpoint.save(path, content | {"fall_network": network.state_dict()})


@reads_files(lambda values, robot: [fall_network_path(values.get("path"))], "path")
def load_fall_network(path: str | None = None) -> FallNetwork:
    """The network of a file that ``recipes.falling.trigger`` wrote.

    Args:
        path: of the file, or the name of one that ships in ``zfall/falling/assets``; ``None``:
            that of the default robot, which sees proprioception alone.

    Raises:
        ValueError: if there is no such file, or it is of another kind.
    """
    file = fall_network_path(path)
    content = checkpoint.load(file, _KINDS)
    with checkpoint.reading(file):
        network = FallNetwork(**content["sizes"])
        network.load_state_dict(content["fall_network"])
    network.trained_with = SHIPPED if path is None else content.get("trained_with")
    return network.eval()
