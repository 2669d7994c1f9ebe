"""Files of jobs on nodes with disks of their own: sent before, fetched while and after they run.

A job works in a folder of its node as if it were the working directory of the sweep: what lies
there is what it reads, and what it wrote before it was cut. What it writes is fetched every few
seconds, so that another node can go on from its last checkpoint.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import gettempdir, mkdtemp
from threading import Event, Thread
from typing import Any

from zfall.cluster.job import Job, Sweep
from zfall.files import written_whole

Files = dict[str, bytes]  # by path in the working directory

_LINES = ".jsonl"  # a file whose lines several jobs add
_PASSING = (".lock", ".tmp")  # endings of files that mean nothing elsewhere
_LAST = "last.pt"  # written after all that belongs to it


class Keeper:
    """The disk of the process that began the sweep, as an actor on its node.

    Args:
        folder: working directory.
        index: folder that says which files came of which job.
        reads: by job, files and folders that it is sent.
        names: by job, what tells it from others, in a later sweep of the same folder, too.
    """

    def __init__(
        self,
        folder: Path,
        index: Path,
        reads: Mapping[int, Sequence[str]],
        names: Mapping[int, str],
    ):
        self.folder, self.reads = folder, reads
        self.indices = {
            number: index / f"{hashlib.sha256(name.encode()).hexdigest()[:16]}.json"
            for number, name in names.items()
        }

    def files_for(self, number: int) -> Files:
        """What a job reads, and what it has written so far."""
        # What its folder holds comes along in any case: a recipe refuses to begin in another's.
        paths = [self.folder / each for each in (*self.reads[number], *self._written(number))]
        within = [each for path in paths for each in (path.rglob("*") if path.is_dir() else [path])]
        return contents(self.folder, [path for path in within if path.is_file()])

    def keep(self, number: int, files: Files, gone: Sequence[str]) -> None:
        """Writes what a job has written, a checkpoint last; removes what is gone."""
        written = dict.fromkeys([*self._written(number), *files])
        index = self.indices[number]
        index.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(index) as new:
            new.write_text(json.dumps([path for path in written if path not in gone]))
        write(self.folder, dict(reversed(files.items())))
        for path in gone:
            (self.folder / path).unlink(missing_ok=True)

    def _written(self, number: int) -> list[str]:
        with suppress(OSError, ValueError):
            return list(json.loads(self.indices[number].read_text()))
        return []


def contents(folder: Path, paths: Sequence[Path]) -> Files:
    """Files by their path in a folder; a checkpoint first, so that the rest is not older."""
    found: Files = {}
    for path in sorted(paths, key=lambda path: (path.name != _LAST, path)):
        if path.suffix not in _PASSING and path.name not in _PASSING:
            with suppress(FileNotFoundError):  # it was replaced just now, and comes the next time
                found[str(path.relative_to(folder))] = path.read_bytes()
    return found


def write(folder: Path, files: Files) -> None:
    """Writes files whole; to one of lines those are added that it does not have."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == _LINES and path.exists():
            before = path.read_bytes()
            known = set(before.splitlines())
            new = [line for line in content.splitlines(keepends=True) if line.strip() not in known]
            content = before + b"".join(new)
        with written_whole(path) as temporary:
            temporary.write_bytes(content)


class Sender:
    """Has a keeper keep what changes in a folder.

    Args:
        folder: whose files are sent.
        number: of the job.
        keeper: handle of a ``Keeper``.
        get: waits for what a call of it returns.
    """

    def __init__(self, folder: Path, number: int, keeper: Any, get: Any):
        self.folder, self.number, self.keeper, self.get = folder, number, keeper, get
        self.sent = self._states()

    def send(self) -> None:
        """Sends files that are new or other than the last time, and names those that are gone."""
        states = self._states()
        changed = [path for path, state in states.items() if self.sent.get(path) != state]
        gone = [str(path.relative_to(self.folder)) for path in self.sent if path not in states]
        if changed or gone:
            files = contents(self.folder, changed)
            self.get(self.keeper.keep.remote(self.number, files, gone))
        self.sent = states

    def _states(self) -> dict[Path, tuple[int, int]]:
        states = {}
        for path in self.folder.rglob("*"):
            with suppress(FileNotFoundError):
                if path.is_file():
                    state = path.stat()
                    states[path] = (state.st_mtime_ns, state.st_size)
        return states


def remove_left_over() -> None:
    """Removes folders of this node's jobs whose processes were killed."""
    for folder in Path(gettempdir()).glob("zfall-[0-9]*-*"):
        pid = folder.name.split("-")[1]
        if pid.isdecimal() and not Path(f"/proc/{pid}").exists() and Path("/proc/self").exists():
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def on_own_disk(job: Job, sweep: Sweep, keeper: Any, every: float) -> Iterator[None]:
    """Works in a folder of this node, whose files come from a keeper and go there.

    Args:
        job: whose files they are.
        sweep: that it is of.
        keeper: handle of a ``Keeper``.
        every: seconds between two looks at what has changed.
    """
    import ray

    remove_left_over()
    before, here = os.getcwd(), Path(mkdtemp(prefix=f"zfall-{os.getpid()}-"))
    try:
        write(here, ray.get(keeper.files_for.remote(job.number)))
        os.chdir(here)
        sender, done = Sender(here, job.number, keeper, ray.get), Event()

        def follow() -> None:
            while not done.wait(every):
                sender.send()

        thread = Thread(target=follow, daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()
            sender.send()
    finally:
        os.chdir(before)
        shutil.rmtree(here, ignore_errors=True)
