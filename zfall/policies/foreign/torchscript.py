"""A network as TorchScript: a program, which runs only where its code is trusted.

TorchScript has operators that write files (``torch.save``, ``torch.from_file``), and a module's
``__setstate__`` runs them while it is loaded. So nothing is loaded unless the user says
``trust=[torch.jit.load]``.
"""

import hashlib
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from zfall.errors import in_one_line
from zfall.trust import trusts

if TYPE_CHECKING:
    from zfall.policies.foreign.network import NetworkTable

Array = NDArray[np.float32]

LOADER = "torch.jit.load"


class TorchScriptNetwork:
    """See ``zfall.policies.foreign.network.Network``.

    Args:
        path: of the file.
        table: nothing of it is needed.

    Raises:
        ValueError: if it is no TorchScript, its code is not trusted, or it cannot be loaded.
    """

    states: Mapping[str, tuple[int, ...]] = {}

    def __init__(self, path: Path, table: "NetworkTable"):
        self.name = path.name
        _check_is_torchscript(path)
        if not trusts(LOADER):
            raise ValueError(
                f"network must be ONNX: {path} is TorchScript, a program that can write files. "
                f"Export the policy as ONNX, or say trust=[{LOADER}] if you trust its code."
            )
        try:
            module: Any = torch.jit.load(str(path), map_location="cpu")
        except RuntimeError as error:
            reason = in_one_line(error)[:200]
            raise ValueError(f"network must be TorchScript, cannot load {path}: {reason}") from None
        self.module = module.eval()
        self.digest = hashlib.sha256(path.read_bytes()).digest()

    def __call__(self, observation: Array, states: Sequence[Array]) -> tuple[Array, list[Array]]:
        """Actions; it keeps no states."""
        with torch.no_grad():
            action = self.module(torch.from_numpy(observation))
        return action.numpy(), []

    def check(self, observation: int, terms: str, action: int) -> None:
        """See ``Network``."""
        before = [value.clone() for value in self.module.buffers()]
        try:
            found = self.module(torch.ones(2, observation))
        except RuntimeError as error:
            reason = " ".join(str(error).strip().splitlines()[-1].split())[:200]
            raise ValueError(
                f"{self.name} must run with the {observation} numbers that the terms give "
                f"({terms}), got: {reason}"
            ) from None
        shape = tuple(found.shape) if isinstance(found, torch.Tensor) else type(found).__name__
        if shape != (2, action):
            raise ValueError(
                f"joints must be as many as the numbers that {self.name} gives of one robot, got "
                f"{action} joints and, of two robots, {shape}."
            )
        after = list(self.module.buffers())
        if any(not torch.equal(old, new) for old, new in zip(before, after, strict=True)):
            raise ValueError(
                f"{self.name} must not keep states in itself, it would mix those of many robots; "
                "export it as ONNX, whose states are inputs and outputs."
            )


def _check_is_torchscript(path: Path) -> None:
    """Whether the parts of a TorchScript are there, without reading any of them."""
    parts: list[str] = []
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            parts = archive.namelist()
    inside = {name.partition("/")[2].partition("/")[0] for name in parts}
    if not {"code", "constants.pkl"} <= inside:
        what = "weights or a checkpoint" if "data.pkl" in inside else "something else"
        raise ValueError(
            f"network must be TorchScript or ONNX, {path} is {what}; export the policy as ONNX in "
            "the framework that trained it."
        )
