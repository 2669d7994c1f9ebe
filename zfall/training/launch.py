"""The processes of a training on this machine: started, watched, and ended together.

Loads no torch: it waits while others work. ``zfall.training.meeting`` is what those do.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode

STORE = "ZFALL_STORE"  # the file by which processes that we start meet
LAUNCHER = "ZFALL_LAUNCHER"  # the process that started them, by number
LOST = 75  # exit code of a rank that has lost another one
_POLL, _PATIENCE = 0.1, 5.0  # between two looks, and for an end that was asked for [s]
_OF_A_RANK = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE")


class RankLost(ConnectionError):
    """Another process of a training has gone, or stands still."""


def is_rank() -> bool:
    """Whether this process is one of several, started by us or by ``torchrun``."""
    return int(os.environ.get("WORLD_SIZE", "1")) > 1 and "RANK" in os.environ


def is_launcher(ranks: int | None, worlds: int) -> bool:
    """Whether this process is to start the ranks of a training.

    Raises:
        ValueError: if it would do so for each of several trainings, or the ``worlds`` do not
            divide; these are 0 if they are not known yet.
    """
    if is_rank() or ranks in (None, 1):
        return False
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        raise ValueError(f"launch.ranks must be null or 1 in a sweep, got {ranks}.")
    if worlds % ranks:
        raise ValueError(f"num_envs must be a multiple of launch.ranks, {ranks}, got {worlds}.")
    return True


def again(module: str, folder: Path | None) -> list[str]:
    """What starts a recipe as this process was, in a folder that is known, for Python."""
    if folder is None:
        return ["-m", module, *sys.argv[1:]]
    path = str(folder).replace("\\", "\\\\").replace("'", "\\'")
    return ["-m", module, *sys.argv[1:], f"hydra.run.dir='{path}'"]


def share_cores() -> None:
    """Binds this process to its part of the cores; call it before torch is loaded.

    Where the system has no such call, or there are fewer cores than processes, nothing is bound.
    """
    count, number = (int(os.environ.get(key, "0")) for key in ("LOCAL_WORLD_SIZE", "LOCAL_RANK"))
    if count < 2 or not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    each = len(cores) // count
    if each:
        os.sched_setaffinity(0, cores[number * each : (number + 1) * each])


def end_with_parent() -> None:
    """Ends this process within a second of whoever started it, however and whenever that ends."""
    parent = int(os.environ.get(LAUNCHER, os.getppid()))

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(LOST)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def one_voice() -> Iterator[None]:
    """Lets one of several processes say what went wrong, and the others end in silence."""
    if not is_rank():
        yield
        return
    share_cores()
    end_with_parent()
    try:
        yield
    except SystemExit as stop:
        if not isinstance(stop.code, str):
            raise
        lost = isinstance(stop.__context__, RankLost)
        told_by_launcher = lost and STORE in os.environ
        if not told_by_launcher:
            _speak(str(stop.code), lost)
        _leave(LOST if lost else 1)


def _leave(code: int) -> None:
    """Ends at once: torch's threads would wait for those that have gone."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


_met: list[Any] = []  # the store, once there is one


def met(store: Any) -> None:
    """Tells where processes that have met agree on who speaks."""
    _met[:] = [store]


def _speak(line: str, lost: bool) -> None:
    """Says it if this is the first to say something; else waits until that one has.

    Who ends first has the others ended, by us or by ``torchrun``, which must not happen before
    the line is written. Before they met, the first of each machine speaks.
    """
    if not _met:
        if os.environ.get("LOCAL_RANK", "0") == "0":
            print(line, file=sys.stderr, flush=True)
        else:
            time.sleep(1.0)
        return
    try:
        if _met[0].add("speaking", 1) == 1:
            print(line, file=sys.stderr, flush=True)
            _met[0].set("spoken", "1")
            return
        until = time.monotonic() + _PATIENCE
        while not _met[0].check(["spoken"]) and time.monotonic() < until:
            time.sleep(_POLL)
    except RuntimeError:  # the store has gone with its process
        if not lost:
            print(line, file=sys.stderr, flush=True)


def run_ranks(command: Sequence[str], ranks: int, folder: Path) -> int:
    """Starts a command in several processes; returns the exit code once all have ended.

    If one ends early, by itself or killed, the others are ended. One line says so, unless one of
    them has said what went wrong. Ctrl-c and SIGTERM are passed on.

    Args:
        command: for Python.
        ranks: how many.
        folder: of the run, for the message.
    """
    with tempfile.TemporaryDirectory(prefix="zfall-") as meeting:
        shared = {**os.environ, STORE: str(Path(meeting) / "store"), LAUNCHER: str(os.getpid())}
        shared |= {"WORLD_SIZE": str(ranks), "LOCAL_WORLD_SIZE": str(ranks)}
        if sys.platform == "linux":  # else gloo asks for the address of the machine's name
            shared.setdefault("GLOO_SOCKET_IFNAME", "lo")
        processes = [
            subprocess.Popen(
                [sys.executable, *command],
                env=shared | {"RANK": str(rank), "LOCAL_RANK": str(rank)},
                start_new_session=True,  # a ctrl-c comes through us, once
            )
            for rank in range(ranks)
        ]
        try:
            with _passed_on(processes):
                codes = _watched(processes)
        finally:
            _end(processes)
    return _verdict(codes, folder)


def _watched(processes: Sequence[subprocess.Popen[bytes]]) -> dict[int, int]:
    """Exit codes by rank, of those that ended first; of all if they end well."""
    while True:
        codes = {rank: each.poll() for rank, each in enumerate(processes)}
        ended = {rank: code for rank, code in codes.items() if code is not None}
        if len(ended) == len(processes) or any(code not in (0, 130) for code in ended.values()):
            if any(code < 0 for code in ended.values()):
                return ended
            time.sleep(_POLL)  # one that was killed is seen after those that have lost it
            return {r: c for r, p in enumerate(processes) if (c := p.poll()) is not None}
        time.sleep(_POLL)


def _verdict(codes: Mapping[int, int], folder: Path) -> int:
    """The exit code of all, and a line for what no rank could say itself."""
    killed = {rank: code for rank, code in codes.items() if code < 0}
    if not killed and all(code in (0, 130) for code in codes.values()):
        return max(codes.values())
    repair = "begin again"
    if (folder / "checkpoints" / "last.pt").exists():
        repair = f"go on with resume={folder}"
    if killed:
        rank, code = next(iter(killed.items()))
        why = f"rank {rank} was ended by {_name_of(-code)}"
    elif all(code in (0, LOST) for code in codes.values()):
        why = "one of them stood still for longer than launch.timeout"
    else:
        return 1  # it has said why
    print(f"error: launch.ranks must all live until the end, {why}; {repair}.", file=sys.stderr)
    return 1


def _name_of(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _end(processes: Sequence[subprocess.Popen[bytes]]) -> None:
    """Ends what still runs, and waits for all, so that none is left."""
    for ask in (signal.SIGTERM, signal.SIGKILL):
        for each in processes:
            if each.poll() is None:
                each.send_signal(ask)
        until = time.monotonic() + _PATIENCE
        while any(each.poll() is None for each in processes) and time.monotonic() < until:
            time.sleep(_POLL)


@contextmanager
def _passed_on(processes: Sequence[subprocess.Popen[bytes]]) -> Iterator[None]:
    """Passes ctrl-c on to all processes; SIGTERM ends them."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        for each in processes:
            if each.poll() is None:
                each.send_signal(number)

    def stop(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = {
        number: signal.signal(number, handler)
        for number, handler in ((signal.SIGINT, interrupt), (signal.SIGTERM, stop))
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
