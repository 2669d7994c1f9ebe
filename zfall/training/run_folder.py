"""The folder of a training run, and the files in it."""

import errno
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from zfall import checkpoint
from zfall.commands import remove_if_empty
from zfall.training.begun import BEGUN
from zfall.training.learner import Learner
from zfall.training.logging import Loggers
from zfall.training.makers import make_file
from zfall.training.optimizers import learning_rates
from zfall.training.parts import drop_parts, write_part
from zfall.training.ranks import ALONE, Ranks
from zfall.training.rows import append_row, keep_rows
from zfall.training.stages import begin_stage, remove_made, stages_of, written_out
from zfall.trust import targets_of, trusting
from zfall.versions import versions

VERSION = 7  # of what is needed to go on; raise it when that changes
LOCK = ".lock"  # file in the folder of a run that trains
WINDOW = 10  # updates over which the best checkpoint is looked for


@contextmanager
def removed_if_unused(folder: Path) -> Iterator[None]:
    """Removes the folder that hydra makes if nothing was put into it, error or not."""
    try:
        yield
    finally:
        remove_if_empty(folder)


@contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Keeps other processes of this machine from training in a folder, which is made if need be.

    The lock is the system's: it ends with the process, however that ends.

    Raises:
        ValueError: if another process trains there.
        OSError: if the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        raise PermissionError(f"the run folder must be writable, {folder} is not.")
    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise ValueError(
            f"a run folder must have one process that trains in it, another trains in {folder}: "
            "wait for its end, or stop it."
        ) from None
    try:
        yield
    finally:
        (folder / LOCK).unlink(missing_ok=True)  # first, or another's lock would be removed
        lock.release()


def holds_run(folder: Path) -> bool:
    """Whether something was trained or made in a folder."""
    return any((folder / name).exists() for name in ("metrics.csv", "checkpoints/last.pt", BEGUN))


@contextmanager
def full_disk_named(folder: Path) -> Iterator[None]:
    """Says of a disk that is full where that is, and what is left of the run.

    Raises:
        OSError: in place of the one that came.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        last = folder / "checkpoints" / "last.pt"
        repair = f"make room and go on with resume={folder}" if last.exists() else "make room"
        raise OSError(f"the disk of {folder} must have room, got {error}; {repair}.") from error


def write_config(cfg: DictConfig, overrides: Sequence[str], folder: Path) -> None:
    """Writes what hydra itself would write before it is known whether the run is refused.

    And, next to it, which code the run is of.
    """
    (folder / ".hydra").mkdir(parents=True, exist_ok=True)
    OmegaConf.save(cfg, folder / ".hydra" / "config.yaml")
    OmegaConf.save(OmegaConf.create(list(overrides)), folder / ".hydra" / "overrides.yaml")
    (folder / ".hydra" / "versions.json").write_text(json.dumps(versions(), indent=2))


def check_version(state: dict[str, Any], folder: Path) -> None:
    """Refuses to go on with a run of another version of this program.

    Raises:
        ValueError: naming both.
    """
    if state.get("version") != VERSION:
        raise ValueError(
            f"{folder} must be a run of version {VERSION} to go on with it, got "
            f"{state.get('version')}; its policy can be read, its training begins anew."
        )


class RunFolder:
    """The files of a run: metrics, timings, checkpoints, and what its loggers write.

    Args:
        folder: the run folder, see ``owned``.
        cfg: of the training, all its stages; its ``logger`` and ``name`` are read.
        ranks: the processes that train; the leading one writes.

    Attributes:
        stage: that is trained at present.
        before: updates and control steps of the stages before it.
    """

    def __init__(self, folder: Path, cfg: DictConfig, ranks: Ranks = ALONE):
        self.folder, self.cfg, self.ranks = folder, cfg, ranks
        self.stages = stages_of(cfg)
        self.stage = self.stages[0]
        self.before = {"updates": 0, "frames": 0}
        folder.mkdir(parents=True, exist_ok=True)
        loggers = (cfg.get("logger") or []) if ranks.leads else []
        self.loggers = Loggers(loggers, folder, cfg.get("name"))
        (folder / "checkpoints").mkdir(exist_ok=True)  # by which a folder is known to be a run's
        self.last = {"episode_return": math.nan, "episode_seconds": math.nan}
        self.recent: list[tuple[float, float]] = []  # of the last updates, see save_last_and_best
        self.best: tuple[float, ...] = ()
        self.columns: dict[str, list[str]] = {}  # of its csv files
        self.went_on = False  # the stage at hand, in this process

    def write(
        self,
        learner: Learner,
        metrics: dict[str, float],
        losses: dict[str, float],
        times: list[float],
        figures: dict[str, float],
    ) -> None:
        """Adds the row of an update; what depends on the clock goes to its own file.

        Args:
            learner: after the update.
            metrics: of the batch.
            losses: of the last pass over it.
            times: when the update began, had its batch, and ended [s].
            figures: more, for the loggers alone.
        """
        self.last |= {key: metrics[key] for key in self.last if key in metrics}
        self.went_on = True
        self.note(metrics)
        if not self.ranks.leads:
            return
        row: dict[str, float] = {"update": self.updates(learner), "frames": self.frames(learner)}
        row |= {"stage": self.stage.number} if self.stage.name else {}
        row |= {**self.last, **metrics}
        row |= {key: losses.pop(key) for key in ("kl", "passes")}
        row |= learning_rates(learner.optimizer)
        for key, value in losses.items():
            row[key if "/" in key else f"loss/{key.removeprefix('loss_')}"] = value
        began, collected, ended = times
        timing: dict[str, float] = {
            "update": row["update"],
            "collect_s": collected - began,
            "learn_s": ended - collected,
            "frames_per_s": learner.frames_per_batch / (ended - began),
        }
        for name, figures_of_update in (("metrics.csv", row), ("timing.csv", timing)):
            self.columns[name] = append_row(self.folder / name, figures_of_update)
        shown = row | figures | {"frames_per_s": timing["frames_per_s"]}
        self.loggers.log(shown, self.frames(learner))

    def note(self, metrics: dict[str, float]) -> None:
        """Remembers how good an update's episodes were, if any ended."""
        if "episode_return" in metrics:
            level = metrics.get("curriculum/level", 0.0)
            self.recent = [*self.recent, (level, metrics["episode_return"])][-WINDOW:]

    def save_last_and_best(self, learner: Learner) -> None:
        """Writes ``last.pt``, and before it ``best.pt`` if the run was never better.

        Better is a higher level of the curriculum (in hundredths), then a higher return of the
        episodes that ended, both in the mean over the last ten updates; with fewer than ten, later.
        As long as no episode has ended, the last is the best.
        """
        levels, returns = zip(*self.recent, strict=True) if self.recent else ((), ())
        count = max(1, len(self.recent))
        score = (len(self.recent), round(sum(levels) / count, 2), sum(returns) / count)
        if score > self.best or not self.recent:
            self.best = score
            self.save(learner, "best")
        self.save(learner, "last")

    def save(self, learner: Learner, name: str) -> None:
        """Writes ``checkpoints/NAME.pt``, of ``last`` every rank its worlds."""
        if name == "last":
            write_part(self.folder, self.ranks, learner.worlds, self.updates(learner))
            self.ranks.gathered(None)  # they are all there
        if not self.ranks.leads:
            return
        content = learner.state_dict() | {"run": self.state_dict(learner)}
        checkpoint.save(self.folder / "checkpoints" / f"{name}.pt", content)
        if name == "last":
            drop_parts(self.folder, self.updates(learner))

    def next_stage(self, learner: Learner | None) -> Learner | None:
        """Keeps what the stage at hand came to; returns the learner of the next.

        Nothing can be trained with the learner of the stage that is over, which is returned if the
        next one makes something in place of training.
        """
        if learner is not None and self.stage.make is None:
            assert self.stage.name is not None
            self.save(learner, self.stage.name)
            self.before = {"updates": self.updates(learner), "frames": self.frames(learner)}
            if self.went_on and self.ranks.leads:  # else they are of what it came to
                remove_made(self.stages[self.stage.number :], self.folder)
            self.went_on = False
            self.ranks.wait()
            learner.worlds.close()
        self.stage = self.stages[self.stage.number]
        if self.stage.make is not None:
            return learner
        self.recent, self.best = [], ()
        with trusting(targets_of(self.cfg)):  # all of them were built before the first began
            return begin_stage(self.stage, self.folder, self.ranks)

    def make_stage(self, console: Console) -> None:
        """Makes what the stage at hand makes in place of training, if it is not there."""
        make, name, files = self.stage.make or {}, str(self.stage.name), self.stage.files
        with trusting(targets_of(self.cfg)):
            make_file(make, name, self.folder, files, self.ranks, console)

    @property
    def at_last_stage(self) -> bool:
        """Whether no stage follows the one at hand."""
        return self.stage.number in (0, len(self.stages))

    def updates(self, learner: Learner) -> int:
        """Of all stages so far."""
        return self.before["updates"] + learner.updates

    def frames(self, learner: Learner) -> int:
        """Control steps of all stages so far."""
        return self.before["frames"] + learner.frames

    def state_dict(self, learner: Learner) -> dict[str, Any]:
        """What the files need to go on from."""
        stages = {
            "whole_config": written_out(self.cfg),
            "stage": self.stage.number,
            "before": self.before,
        }
        return {
            **(stages if self.stage.name else {}),
            "version": VERSION,
            "ranks": self.ranks.size,
            "updates": self.updates(learner),
            "last": self.last,
            "recent": self.recent,
            "best": self.best,
            "columns": self.columns,
        }

    def load_state_dict(self, state: dict[str, Any]) -> list[str]:
        """Goes on from a checkpoint: rows written after it are dropped.

        Returns:
            What its files have lost, a line for each that was damaged; training goes on without.
        """
        self.stage = self.stages[max(0, state.get("stage", 0) - 1)]
        self.before = dict(state.get("before", self.before))
        self.last, self.recent, self.best = state["last"], state["recent"], state["best"]
        self.columns = dict(state.get("columns", {}))
        lost: list[str] = []
        if not self.ranks.leads:
            return lost
        for name in ("metrics.csv", "timing.csv"):
            path = self.folder / name
            missing = keep_rows(path, self.columns.get(name, ()), state["updates"])
            if missing:
                lost.append(
                    f"{path} has lost {missing} of {state['updates']} rows; the checkpoint is "
                    "sound, training goes on without them."
                )
        return lost
