"""What a network in a file is to us, and which class reads it, by the ending of its name."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NotRequired, Protocol, TypedDict

import numpy as np
from numpy.typing import NDArray

from zfall.policies.foreign.onnx import OnnxNetwork
from zfall.policies.foreign.torchscript import TorchScriptNetwork
from zfall.values import Name

Array = NDArray[np.float32]


class NetworkTable(TypedDict):
    """``network`` of the yaml: a file, and which of its inputs and outputs is which."""

    file: Name
    observation: NotRequired[Name | None]
    action: NotRequired[Name | None]
    states: NotRequired[Mapping[Name, Name]]


class Network(Protocol):
    """A network that was read from a file.

    Attributes:
        digest: tells its content from that of any other.
        states: shapes of what it keeps from step to step, of one robot, by name; it begins with 0.
    """

    digest: bytes
    states: Mapping[str, tuple[int, ...]]

    def __call__(self, observation: Array, states: Sequence[Array]) -> tuple[Array, list[Array]]:
        """Actions ``(B, A)`` and next states ``(B, ...)``, of observations ``(B, D)``."""

    def check(self, observation: int, terms: str, action: int) -> None:
        """Refuses sizes of observation and action that are not those of the network.

        Args:
            observation: numbers that the yaml's terms give.
            terms: which they are, for the message.
            action: joints that the yaml names.

        Raises:
            ValueError: naming what does not fit.
        """


READERS: Mapping[str, Callable[[Path, NetworkTable], Network]] = {
    ".onnx": OnnxNetwork,
    ".pt": TorchScriptNetwork,
    ".pth": TorchScriptNetwork,
    ".jit": TorchScriptNetwork,
}


def read_network(path: Path, table: NetworkTable) -> Network:
    """The network in a file.

    Raises:
        ValueError: if there is no such file, or its ending or content is none that we read.
    """
    if not path.is_file():
        raise ValueError(
            f"network must be a file, there is no {path}; its name counts from the folder of the "
            "yaml."
        )
    if path.suffix not in READERS:
        raise ValueError(f"network must end with {', '.join(READERS)}, got {path.name}.")
    return READERS[path.suffix](path, table)
