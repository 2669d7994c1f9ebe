"""A job of a hydra sweep, on the node that Ray gave it to."""

import os
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from hydra.core.singleton import Singleton
from hydra.core.utils import JobStatus, run_job, setup_globals
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from zfall.cores import use_cores
from zfall.errors import SPOKEN, in_one_line
from zfall.versions import package_versions


@dataclass(frozen=True)
class Job:
    """One of the jobs of a sweep.

    Args:
        number: in the sweep.
        config: hydra's and the recipe's.
        folder: that hydra makes for it.
        log: file to which all that it prints is added.
    """

    number: int
    config: DictConfig
    folder: Path
    log: Path

    @property
    def name(self) -> str:
        """What differs in it, in one line."""
        return f"#{self.number} {' '.join(self.config.hydra.overrides.task)}"


@dataclass(frozen=True)
class Sweep:
    """What the jobs of a sweep share.

    Args:
        recipe: module whose ``main`` they run.
        context: hydra's.
        singletons: hydra's, of the process that began the sweep.
        folder: working directory.
        cores: of a job.
        versions: of the packages there.
        sign: a file that whoever sees the disk of that process sees.
    """

    recipe: str
    context: HydraContext
    singletons: Any
    folder: Path
    cores: int
    versions: dict[str, str]
    sign: Path


@dataclass(frozen=True)
class Ending:
    """How a job ended.

    Args:
        value: that the recipe returned.
        error: why it failed, in one line; empty if it did not.
    """

    value: Any = None
    error: str = ""


def recipe_of(task: TaskFunction) -> str:
    """The module of a recipe, by which another process finds it.

    Raises:
        ValueError: if it was not started as a module.
    """
    name = task.__module__
    if name == "__main__":
        spec = sys.modules[name].__spec__
        if spec is None:
            file = getattr(sys.modules[name], "__file__", "a script")
            raise ValueError(
                f"hydra/launcher=ray must be used with a module, python -m NAME, got {file}."
            )
        name = spec.name
    return name


def task_of(recipe: str) -> TaskFunction:
    """What hydra calls with the config: the recipe's ``main``, without hydra around it."""
    task: TaskFunction = import_module(recipe).main.__wrapped__
    return task


def execute(job: Job, sweep: Sweep, around: Callable[[Job, Sweep], Any] | None = None) -> Ending:
    """Runs a job, in a worker of Ray's; whatever goes wrong in it is in what it returns.

    Args:
        job: which.
        sweep: that it is of.
        around: a context manager that has its files at hand; ``None``: the disk is shared.
    """
    try:
        check_same(sweep.versions)
        with (around or on_shared_disk)(job, sweep), printing_into(job.log):
            return _run(job, sweep)
    except SPOKEN as error:
        return Ending(error=in_one_line(error))


def check_same(wanted: dict[str, str]) -> None:
    """Refuses a node with other versions than where the sweep began.

    Raises:
        ValueError: naming node, package and both.
    """
    for name, found in package_versions().items():
        if found != wanted[name]:
            raise ValueError(
                f"all nodes must have the same packages, {os.uname().nodename} has {name} {found}, "
                f"the sweep began with {wanted[name]}."
            )


@contextmanager
def on_shared_disk(job: Job, sweep: Sweep) -> Iterator[None]:
    """Works in the directory in which the sweep began.

    Raises:
        ValueError: if this node does not see its disk.
    """
    if not sweep.sign.exists():
        raise ValueError(
            f"hydra.launcher.shared must be false if nodes have disks of their own: "
            f"{os.uname().nodename} does not see {sweep.sign.parent}."
        )
    os.chdir(sweep.folder)
    yield


@contextmanager
def printing_into(log: Path) -> Iterator[None]:
    """Adds to a file whatever is printed."""
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a", buffering=1) as file, redirect_stdout(file), redirect_stderr(file):
        yield


def _run(job: Job, sweep: Sweep) -> Ending:
    """Runs the recipe as hydra's own launcher does, on as many cores as the job has."""
    setup_globals()
    Singleton.set_state(sweep.singletons)
    use_cores(sweep.cores)
    try:
        done = run_job(
            hydra_context=sweep.context,
            task_function=task_of(sweep.recipe),
            config=job.config,
            job_dir_key="hydra.sweep.dir",
            job_subdir_key="hydra.sweep.subdir",
        )
    except SystemExit as stop:  # a recipe's way to say what is wrong
        if stop.code in (None, 0):
            return Ending()
        text = "stopped" if stop.code == 130 else str(stop.code)
        print(text)
        return Ending(error=text.removeprefix("error: "))
    if done.status == JobStatus.COMPLETED:
        return Ending(done.return_value)
    error = done._return_value
    traceback.print_exception(error)
    return Ending(error=in_one_line(error))
