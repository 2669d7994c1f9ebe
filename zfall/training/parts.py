"""The worlds of a training's ranks in its run folder: a file for each rank but the leading one.

``last.pt`` is whole only with the parts of its update. They are written before it and removed
after the next, so that it has them whenever a rank is killed.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zfall import checkpoint
from zfall.training.collection import Worlds
from zfall.training.ranks import Ranks

_KINDS: checkpoint.Kinds = {"worlds": list}


def write_part(folder: Path, ranks: Ranks, worlds: Worlds, updates: int) -> None:
    """Writes what a rank's worlds are in after so many updates; the leading one's is elsewhere."""
    if ranks.leads:
        return
    path = part_of(folder, ranks.rank, ranks.size, updates)
    path.parent.mkdir(parents=True, exist_ok=True)
    checkpoint.save(path, {"worlds": worlds.state_dict()})


def drop_parts(folder: Path, updates: int) -> None:
    """Removes parts of other updates."""
    for path in folder.glob("checkpoints/parts/*.pt"):
        if not path.name.startswith(f"{updates}-"):
            path.unlink(missing_ok=True)


def with_own_worlds(state: Mapping[str, Any], folder: Path, ranks: Ranks) -> dict[str, Any]:
    """The content of ``last.pt`` with the worlds of this rank.

    Had the run another number of ranks, ``redrawn`` are the worlds of all of them in their order,
    from which new ones begin.

    Raises:
        ValueError: if a part is missing or damaged.
    """
    run = state["run"]
    size = run.get("ranks", 1)
    if size == ranks.size and ranks.leads:
        return dict(state)
    wanted = range(1, size) if size != ranks.size else [ranks.rank]
    parts = {}
    for rank in wanted:
        path = part_of(folder, rank, size, run["updates"])
        if not path.is_file():
            raise ValueError(
                f"{path} must be there to go on with a run of {size} ranks, it holds the worlds "
                f"of rank {rank}: put it back, or begin anew."
            )
        parts[rank] = checkpoint.load(path, _KINDS)["worlds"]
    if size == ranks.size:
        return {**state, "worlds": parts[ranks.rank]}
    everyone = [*state["worlds"], *(world for rank in wanted for world in parts[rank])]
    return {**state, "worlds": [], "redrawn": everyone}


def part_of(folder: Path, rank: int, size: int, updates: int) -> Path:
    """Where a rank's worlds after so many updates are."""
    return folder / "checkpoints" / "parts" / f"{updates}-{rank}-of-{size}.pt"
