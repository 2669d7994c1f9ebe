"""What tells a value, a file or a policy from all others."""

import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

import torch

from zfall import checkpoint

Built = TypeVar("Built", bound=Callable[..., Any])
Reads = Callable[[Mapping[str, Any], Any], list[Path]]  # of values in the yaml, and the robot


def digest(value: Any) -> str:
    """Twelve digits that tell a value from all others."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:12]


def file_digest(path: Path) -> str:
    """Tells the content of a file from all others; a checkpoint's are its tensors.

    What else a checkpoint says, such as the version that wrote it, may change.
    """
    return _file_digest(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=256)
def _file_digest(path: Path, changed: int) -> str:
    if path.suffix == ".pt":
        with suppress(ValueError):  # else whoever reads it says so
            known = hashlib.sha256()
            for key, tensor in sorted(checkpoint.tensors_of(path).items()):
                known.update(f"{key} {tensor.dtype} {tuple(tensor.shape)}".encode())
                known.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
            return known.hexdigest()
    return hashlib.sha256(path.read_bytes()).hexdigest()


def weights_digest(actor: torch.nn.Module | None) -> str:
    """Tells the weights of a policy from those of any other."""
    values = [] if actor is None else actor.state_dict().values()
    return hashlib.sha256(b"".join(value.numpy().tobytes() for value in values)).hexdigest()


def reads_files(paths: Reads, argument: str = "files") -> Callable[[Built], Built]:
    """Says of a class or function that yaml builds which files it reads.

    What it does depends on their content: ``zfall.envs.tables.contents_of`` takes it in.

    Args:
        paths: from the values in the yaml and the robot to the files.
        argument: with which the yaml names them, if it can. Its value then counts by what the
            files hold, wherever they lie.
    """

    def mark(built: Built) -> Built:
        cast(Any, built).files_read = paths
        cast(Any, built).files_argument = argument
        return built

    return mark
