"""What a run goes on from before its first checkpoint, if its first stage makes a file."""

import json
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from zfall.files import written_whole
from zfall.training.stages import written_out

BEGUN = "checkpoints/begun.json"


def write_begun(cfg: DictConfig, folder: Path, version: int) -> None:
    """Writes what ``load_begun`` reads.

    Args:
        cfg: of the training, all its stages.
        folder: of the run.
        version: of what is needed to go on.
    """
    (folder / BEGUN).parent.mkdir(parents=True, exist_ok=True)
    with written_whole(folder / BEGUN) as new:
        new.write_text(json.dumps({"version": version, "whole_config": written_out(cfg)}))


def load_begun(folder: Path) -> dict[str, Any]:
    """What a run was begun with that has no checkpoint yet, in the form of that of ``last.pt``.

    Raises:
        ValueError: if there is none, or it is damaged.
    """
    path = folder / BEGUN
    if not path.is_file():
        raise ValueError(f"resume must be a run with checkpoints/last.pt, {folder} has none yet.")
    try:
        begun = dict(json.loads(path.read_text()))
        return {"version": begun["version"], "whole_config": str(begun["whole_config"])}
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} must be as it was written, it is damaged: begin anew.") from error
