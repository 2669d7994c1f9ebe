"""Several processes that train together, for tests."""

import multiprocessing
import os
import pickle
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import torch
from omegaconf import DictConfig

from zfall.configs import compose_config
from zfall.training.launch import STORE, one_voice


class Ended(NamedTuple):
    """How a process ended."""

    code: int | None
    out: str
    err: str


PRELOAD = ["recipes.train", "zfall.training.begin", "zfall.evaluation.showcase"]


def in_each(
    function: Callable[..., Any], size: int, folder: Path, *args: Any, port: int | None = None
) -> list[Any]:
    """What ``function(*args)`` gives in each of several processes that can meet, by rank.

    An error is given in its place. They meet in a file in the folder, or as those that others
    start, at a ``port`` of this machine.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOAD)
    folder.mkdir(parents=True, exist_ok=True)
    processes = [
        context.Process(target=_work, args=(function, rank, size, folder, args, port))
        for rank in range(size)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join(600)
        assert process.exitcode == 0
    return [pickle.loads((folder / f"{rank}.pickle").read_bytes()) for rank in range(size)]


def _work(
    function: Callable[..., Any],
    rank: int,
    size: int,
    folder: Path,
    args: tuple[Any, ...],
    port: int | None,
) -> None:
    os.environ |= {"RANK": str(rank), "WORLD_SIZE": str(size)}
    if port is None:
        os.environ[STORE] = str(folder / "store")
    else:
        os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
    os.environ.setdefault("GLOO_SOCKET_IFNAME", "lo")
    torch.set_num_threads(1)
    try:
        result = function(*args)
    except Exception as error:
        traceback.print_exc()
        result = error
    (folder / f"{rank}.pickle").write_bytes(pickle.dumps(result))
    os._exit(0)  # those that have gone would be waited for


def config(*overrides: str) -> DictConfig:
    """Of a training in this process."""
    return compose_config(overrides)


def train_in_each(overrides: list[list[str]], folder: Path, size: int | None = None) -> list[Ended]:
    """``python -m recipes.train`` in processes that meet, as ``launch.ranks`` starts them.

    Args:
        overrides: of each.
        folder: for their meeting.
        size: how many they think that there are; ``None``: as many as there are.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOAD)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "store").unlink(missing_ok=True)
    processes = [
        context.Process(target=_train, args=(own, rank, size or len(overrides), folder))
        for rank, own in enumerate(overrides)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join(600)
    ended = []
    for rank, process in enumerate(processes):
        texts = [(folder / f"{rank}.{name}").read_text() for name in ("out", "err")]
        ended.append(Ended(process.exitcode, *texts))
    return ended


def _train(overrides: list[str], rank: int, size: int, folder: Path) -> None:
    from recipes import train
    from recipes.shell import start

    os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank), "WORLD_SIZE": str(size)}
    os.environ["LOCAL_WORLD_SIZE"] = str(size)  # so many threads as ranks that are launched
    os.environ |= {"GLOO_SOCKET_IFNAME": "lo", STORE: str(folder / "store")}
    for name, number in (("out", 1), ("err", 2)):
        os.dup2(os.open(folder / f"{rank}.{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    sys.argv = ["recipes/train.py", *overrides]
    with one_voice():
        start(train.main)
