"""Where the processes of a training meet, and see that they are of one mind."""

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from omegaconf import DictConfig

from zfall.configs import plain_containers
from zfall.cores import usable_cores
from zfall.training.launch import STORE, RankLost, is_rank, met
from zfall.training.ranks import ALONE, Ranks
from zfall.training.run_folder import LOCK, owned
from zfall.training.several_ranks import SeveralRanks
from zfall.values import shown
from zfall.versions import package_versions

_POLL = 0.05  # [s]
_OWN = ("hydra",)  # keys that ranks need not agree on


@contextmanager
def ranks_of(cfg: DictConfig) -> Iterator[Ranks]:
    """The processes that share a training, of which this is one; within it they can talk.

    Args:
        cfg: of the training; ``launch`` and ``device`` are read.

    Raises:
        ValueError: if ``launch.ranks`` is another number than there are, a rank does not come, or
            has another config or version.
    """
    if not is_rank():
        yield ALONE
        return
    rank, size = int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"])
    torch.set_num_threads(usable_cores())
    wait = timedelta(seconds=cfg.launch.timeout)
    store = _store(rank, size, wait)
    met(store)
    _all_here(store, rank, size, cfg.launch.timeout)
    backend = "cpu:gloo,cuda:nccl" if str(cfg.device).startswith("cuda") else "gloo"
    try:
        dist.init_process_group(backend, store=store, rank=rank, world_size=size, timeout=wait)
    except (RuntimeError, dist.DistError) as error:
        raise RankLost(f"launch.ranks must reach each other, {_first_line(error)}.") from error
    ranks = SeveralRanks(store, cfg.launch.timeout)
    _check_one_mind(ranks, cfg)
    if cfg.launch.ranks not in (None, size):
        raise ValueError(
            f"launch.ranks must be null or the {size} processes that were started, "
            f"got {cfg.launch.ranks}."
        )
    try:
        yield ranks
    except SystemExit as stop:
        if isinstance(stop.code, str):  # others may have gone, and would be waited for
            raise
        dist.destroy_process_group()
        raise
    dist.destroy_process_group()


def _store(rank: int, size: int, wait: timedelta) -> dist.Store:
    """What all of them reach: a file of ours, or what ``torchrun`` provides."""
    if STORE in os.environ:
        return dist.FileStore(os.environ[STORE], size)
    try:
        store, _, _ = next(iter(dist.rendezvous("env://", rank, size, timeout=wait)))
    except (RuntimeError, ValueError, dist.DistError) as error:
        raise ValueError(
            f"MASTER_ADDR and MASTER_PORT must lead to where all {size} ranks meet, rank {rank} "
            f"met nobody: {_first_line(error)}."
        ) from error
    return store


def _all_here(store: dist.Store, rank: int, size: int, seconds: float) -> None:
    """Waits until all ranks have come.

    Raises:
        ValueError: naming those that have not.
    """
    store.set(f"here/{rank}", "1")
    until = time.monotonic() + seconds
    while missing := [other for other in range(size) if not store.check([f"here/{other}"])]:
        if time.monotonic() > until:
            names = ", ".join(map(str, missing))
            raise ValueError(
                f"launch.ranks must all come within launch.timeout, {seconds:g} s, of {size} "
                f"there are missing: {names}."
            )
        time.sleep(_POLL)


def _check_one_mind(ranks: SeveralRanks, cfg: DictConfig) -> None:
    """Refuses ranks that would train something else.

    Raises:
        ValueError: naming the first difference.
    """
    known = {f"{name}'s version": number for name, number in package_versions().items()}
    flat = dict(_leaves(plain_containers(cfg)))
    everyone = ranks.gathered(known | flat)
    for rank, other in enumerate(everyone):
        for key in {**everyone[0], **other}:
            mine, theirs = everyone[0].get(key), other.get(key)
            if mine != theirs:
                raise ValueError(
                    f"{key} must be the same on all ranks, got {shown(mine)} on rank 0 and "
                    f"{shown(theirs)} on rank {rank}."
                )


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping) and value:
        for key, entry in value.items():
            yield from _leaves(entry, f"{place}.{key}".lstrip("."))
    elif place.partition(".")[0] not in _OWN:
        yield place, value


def shared_folder(ranks: Ranks, made: Path) -> Path:
    """The run folder of the leading rank."""
    return Path(ranks.gathered(str(made))[0])


@contextmanager
def owned_by_all(folder: Path, ranks: Ranks) -> Iterator[None]:
    """Keeps others from training in a folder, which all ranks must see.

    Raises:
        ValueError: if others train there, or naming the first rank that does not see it.
    """
    with owned(folder) if ranks.leads else nullcontext():
        ranks.wait()
        for rank, sees in enumerate(ranks.gathered((folder / LOCK).exists())):
            if not sees:
                raise ValueError(
                    "hydra.run.dir must be a folder that all machines share, rank "
                    f"{rank} does not see {folder}."
                )
        yield


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
