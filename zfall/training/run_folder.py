"""The folder of a training run, and the files in it."""

import csv
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from zfall import checkpoint
from zfall.commands import remove_if_empty
from zfall.training.learner import Learner
from zfall.training.logging import Loggers

VERSION = 7  # of what is needed to go on; raise it when that changes
WINDOW = 10  # updates over which the best checkpoint is looked for


@contextmanager
def removed_if_unused(folder: Path) -> Iterator[None]:
    """Removes the folder that hydra makes if nothing was put into it, error or not."""
    try:
        yield
    finally:
        remove_if_empty(folder)


def write_config(cfg: DictConfig, overrides: Sequence[str], folder: Path) -> None:
    """Writes what hydra itself would write before it is known whether the run is refused."""
    (folder / ".hydra").mkdir(parents=True, exist_ok=True)
    OmegaConf.save(cfg, folder / ".hydra" / "config.yaml")
    OmegaConf.save(OmegaConf.create(list(overrides)), folder / ".hydra" / "overrides.yaml")


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
        folder: the run folder.
        cfg: of the training, whose ``logger`` and ``name`` are read.

    Raises:
        OSError: if it cannot be written.
    """

    def __init__(self, folder: Path, cfg: DictConfig):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(f"hydra.run.dir must be writable, {folder} is not.")
        self.loggers = Loggers(cfg.get("logger") or [], folder, cfg.get("name"))
        (folder / "checkpoints").mkdir(exist_ok=True)  # by which a folder is known to be a run's
        self.last = {"episode_return": math.nan, "episode_seconds": math.nan}
        self.recent: list[tuple[float, float]] = []  # of the last updates, see save_last_and_best
        self.best: tuple[float, ...] = ()

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
        self.note(metrics)
        row = {"update": learner.updates, "frames": learner.frames, **self.last, **metrics}
        row |= {key: losses.pop(key) for key in ("kl", "passes")}
        row["learning_rate"] = learner.optimizer.param_groups[0]["lr"]
        row |= {f"loss/{k.removeprefix('loss_')}": v for k, v in losses.items()}
        began, collected, ended = times
        timing = {
            "update": learner.updates,
            "collect_s": collected - began,
            "learn_s": ended - collected,
            "frames_per_s": learner.frames_per_batch / (ended - began),
        }
        append_row(self.folder / "metrics.csv", row)
        append_row(self.folder / "timing.csv", timing)
        self.loggers.log(row | figures | {"frames_per_s": timing["frames_per_s"]}, learner.frames)

    def note(self, metrics: dict[str, float]) -> None:
        """Remembers how good an update's episodes were, if any ended."""
        if "episode_return" in metrics:
            level = metrics.get("curriculum/level", 0.0)
            self.recent = [*self.recent, (level, metrics["episode_return"])][-WINDOW:]

    def save_last_and_best(self, learner: Learner) -> None:
        """Writes ``last.pt``, and before it ``best.pt`` if the run was never better.

        Better is a higher level of the curriculum (in hundredths), then a higher return of the
        episodes that ended, both in the mean over the last ten updates; with fewer than ten, later.
        """
        levels, returns = zip(*self.recent, strict=True) if self.recent else ((), ())
        count = max(1, len(self.recent))
        score = (len(self.recent), round(sum(levels) / count, 2), sum(returns) / count)
        if score > self.best:
            self.best = score
            self.save(learner, "best")
        self.save(learner, "last")

    def save(self, learner: Learner, name: str) -> None:
        """Writes ``checkpoints/NAME.pt``."""
        content = learner.state_dict() | {"run": self.state_dict(learner.updates)}
        checkpoint.save(self.folder / "checkpoints" / f"{name}.pt", content)

    def state_dict(self, updates: int) -> dict[str, Any]:
        """What the files need to go on from."""
        return {
            "version": VERSION,
            "updates": updates,
            "last": self.last,
            "recent": self.recent,
            "best": self.best,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from a checkpoint: rows written after it are dropped."""
        self.last, self.recent, self.best = state["last"], state["recent"], state["best"]
        for name in ("metrics.csv", "timing.csv"):
            path = self.folder / name
            header, *rows = path.read_text().splitlines(keepends=True)
            whole = (row for row in rows if row.endswith("\n"))
            kept = [row for row in whole if int(row.split(",", 1)[0]) <= state["updates"]]
            path.with_suffix(".tmp").write_text("".join([header, *kept]))
            path.with_suffix(".tmp").replace(path)


def append_row(path: Path, row: dict[str, Any]) -> None:
    """Adds a row to a csv file, with a header if it is the first."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(row), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(row)
