"""What tells a value, a file or a policy from all others."""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

import torch

Built = TypeVar("Built", bound=Callable[..., Any])
Reads = Callable[[Mapping[str, Any], Any], list[Path]]  # of values in the yaml, and the robot


def digest(value: Any) -> str:
    """Twelve digits that tell a value from all others."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:12]


def file_digest(path: Path) -> str:
    """Tells the content of a file from all others."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def weights_digest(actor: torch.nn.Module | None) -> str:
    """Tells the weights of a policy from those of any other."""
    values = [] if actor is None else actor.state_dict().values()
    return hashlib.sha256(b"".join(value.numpy().tobytes() for value in values)).hexdigest()


def reads_files(paths: Reads) -> Callable[[Built], Built]:
    """Says of a class or function that yaml builds which files it reads.

    A world depends on their content: ``zfall.envs.tables.env_digest`` takes it in.

    Args:
        paths: from the values in the yaml and the robot to the files.
    """

    def mark(built: Built) -> Built:
        cast(Any, built).files_read = paths
        return built

    return mark
