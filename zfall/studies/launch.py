"""One bar for a whole study, and its runs handed to other processes."""

import json
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from rich.console import Console
from rich.progress import Progress, TextColumn
from rich.table import Column

from zfall.studies.plan import Run
from zfall.studies.store import Store
from zfall.terminal import progress_bar

if TYPE_CHECKING:
    from zfall.studies.study import Study


@contextmanager
def progress_of(study: "Study", store: Store, console: Console) -> Iterator[None]:
    """Shows how many frames of the study are trained, whatever process trains them."""
    count = TextColumn("{task.completed}/{task.total} M frames", table_column=Column(no_wrap=True))
    with progress_bar(console, count) as bar:
        done = threading.Event()
        # Paths and numbers alone: a config that one thread copies cannot be read in another.
        folders = [[store.run_folder(each) for each in run.trainings] for run in study.plan]
        frames = {
            folder: int(each.total_frames)
            for run, own in zip(study.plan, folders, strict=True)
            for each, folder in zip(run.trainings, own, strict=True)
        }
        given = (bar, study.name, study.plan, folders, frames, store, done)
        follower = threading.Thread(target=follow, args=given)
        follower.start()
        try:
            yield
        finally:
            done.set()
            follower.join()


def follow(
    bar: Progress,
    name: str,
    runs: Sequence[Run],
    folders: Sequence[Sequence[Path]],
    frames: Mapping[Path, int],
    store: Store,
    done: threading.Event,
) -> None:
    """Keeps the bar up to date, from the files of the runs.

    Args:
        bar: shows millions of frames.
        name: of the study.
        runs: of the study.
        folders: of the trainings of each run.
        frames: to be trained in each folder.
        store: has the results.
        done: ends it.
    """
    task = bar.add_task(f"study {name}", total=round(sum(frames.values()) / 1e6, 2))
    while not done.wait(2.0):
        pairs = zip(runs, folders, strict=True)
        needed = {folder for run, own in pairs if store.unfinished(run) for folder in own}
        trained = sum(
            frames_done(total, folder) if folder in needed else total
            for folder, total in frames.items()
        )
        bar.update(task, completed=round(trained / 1e6, 2))


def frames_done(total: int, folder: Path) -> int:
    """Frames of a training so far, of those it is to have."""
    path = folder / "metrics.csv"
    text = path.read_text(errors="replace") if path.exists() else ""
    for line in reversed(text.split("\n")[1:-1]):  # the last line may be half written
        _, *cells = line.split(",")
        if cells and cells[0].isdecimal():
            return min(int(cells[0]), total)
    return 0


def sweep(
    key: str,
    values: Sequence[Any],
    *,
    module: str,
    launcher: str,
    launch: Mapping[str, Any] | None,
    log: Path,
    more: Sequence[str] = (),
) -> None:
    """Starts the recipe that runs now once more, as a hydra sweep; it ends with this process.

    Args:
        key: that differs from job to job.
        values: of it, one for each job.
        module: of the recipe, ``recipes.ablate``.
        launcher: hydra's, which decides where each job runs.
        launch: values of the launcher; None: its own.
        log: file to which all that is printed is added.
        more: overrides for all jobs.
    """
    config = HydraConfig.get()
    given = config.overrides.task  # which study, and what of it was changed
    command = [sys.executable, "-m", "zfall.with_parent", module, "-m", *given, *more]
    command += [f"{key}={','.join(map(_written, values))}", f"hydra/launcher={launcher}"]
    command += [f"hydra.launcher.{key}={_written(value)}" for key, value in (launch or {}).items()]
    for source in config.runtime.config_sources:
        if source.provider == "command-line":  # a folder of the user's own studies
            command.append(f"--config-dir={source.path}")
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a") as file:
        code = _end_of(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=file, stderr=file))
    if code:
        last = (log.read_text().strip().splitlines() or ["nothing"])[-1]
        print(f"error: launcher {launcher} failed ({log}): {last}", file=sys.stderr)


def _end_of(program: subprocess.Popen[bytes]) -> int:
    """Waits for a program; what interrupts the wait ends the program as well."""
    try:
        return program.wait()
    except BaseException:
        assert program.stdin is not None
        program.stdin.close()
        program.wait()
        raise


def _written(value: Any) -> str:
    """A value as hydra reads it."""
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{_written(each)}" for key, each in value.items()) + "}"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, Sequence):
        return "[" + ",".join(map(_written, value)) + "]"
    return "null" if value is None else str(value)
