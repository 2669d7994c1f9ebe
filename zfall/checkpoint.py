"""Checkpoints: written whole or not at all, read without executing code."""

import os
from pathlib import Path
from typing import Any

import torch

from zfall.moved import with_new_paths

FORMAT = 7  # raise it when policies written before can no longer be read


def save(path: Path, content: dict[str, Any]) -> None:
    """Writes tensors, numbers, text and containers of them to ``path``.

    The file is written under a temporary name and then renamed, so that a crash leaves the old
    one.
    """
    temporary = path.with_suffix(".tmp")
    torch.save({"format": FORMAT, **content}, temporary)
    os.replace(temporary, path)


def load(path: Path) -> dict[str, Any]:
    """Reads what ``save`` wrote.

    Raises:
        ValueError: if the file does not exist, is no checkpoint, or is of another format.
    """
    if not path.is_file():
        raise ValueError(f"{path} must be a checkpoint, there is no such file.")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ValueError(f"{path} must be a checkpoint, cannot read it: {reason}") from error
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT:
        raise ValueError(
            f"{path} must be a checkpoint of format {FORMAT}, got {found}; train it again, or "
            "read it with the version that wrote it."
        )
    if isinstance(content.get("config"), str):
        content["config"] = with_new_paths(content["config"])
    return content


def check_fits(content: dict[str, Any], robot: str, actor: torch.nn.Module, path: Path) -> None:
    """Refuses a checkpoint whose robot or actor is another.

    Raises:
        ValueError: naming what differs.
    """
    if content["robot"] != robot:
        raise ValueError(f"{path} must be of the robot {robot}, it is of {content['robot']}.")
    mine = {key: tuple(value.shape) for key, value in actor.state_dict().items()}
    theirs = {key: tuple(value.shape) for key, value in content["actor"].items()}
    if mine != theirs:
        differing = sorted(k for k in mine.keys() | theirs.keys() if mine.get(k) != theirs.get(k))
        key = differing[0]
        raise ValueError(
            f"{path} must hold the configured actor, but {key} has shape {theirs.get(key)} there "
            f"and {mine.get(key)} here; give the actor and env it was trained with."
        )
