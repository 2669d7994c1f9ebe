"""Trains a policy and shows what it can do: ``python -m recipes.train experiment=quickstart``."""

import csv
import gc
import math
import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torchrl.record import TensorboardLogger

from recipes.learner import Learner
from recipes.metrics import batch_metrics
from recipes.one_line import check_keys, one_line_errors, shell_line, shown_path, start
from recipes.showcase import show
from recipes.warm_start import warm_start
from zfall import checkpoint
from zfall.envs.model import identity_of

KEYS = {
    *("seed", "num_envs", "total_frames", "rollout_steps", "epochs", "minibatches", "burn_in"),
    *("max_grad_norm", "averaging", "resume", "warm_start", "checkpoint_every", "showcase"),
    *("env", "actor", "critic", "loss", "optimizer", "scheduler", "experiment"),
    *("auxiliary_losses", "auxiliary_share", "augmentation"),
}
VERSION = 2  # of what is needed to go on; raise it when that changes
WINDOW = 10  # updates over which the best checkpoint is looked for
LOSS_KEYS = {
    *("gamma", "lmbda", "clip_epsilon", "critic_coeff", "entropy_coeff"),
    *("normalize_advantage", "kl_stop", "kl_coeff", "kl_target", "value_clip", "value_error_clip"),
}


@hydra.main(version_base=None, config_path=".", config_name="train")
def main(cfg: DictConfig) -> None:
    """Trains until ``total_frames``; ctrl-c ends it early, with a checkpoint to resume from."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors(), removed_if_unused(folder):
        check_keys(cfg, KEYS)
        if not (isinstance(cfg.total_frames, (int, float)) and cfg.total_frames > 0):
            raise ValueError(f"total_frames must be a positive number, got {cfg.total_frames}.")
        check_keys(cfg.loss, LOSS_KEYS, "loss.")
        check_keys(cfg.showcase or OmegaConf.create({}), {"sizes", "starts", "video"}, "showcase.")
        state = None
        if cfg.resume is not None:
            folder = Path(cfg.resume)
            state = checkpoint.load(folder / "checkpoints" / "last.pt")
            cfg = resumed_config(state["config"], HydraConfig.get().overrides.task, folder)
        elif (folder / "metrics.csv").exists():
            raise ValueError(
                f"hydra.run.dir must be a folder without a run, {folder} holds one; "
                f"resume={shown_path(folder)} goes on with it."
            )
        try_one_step(cfg.env)
        learner = Learner(cfg)
        if cfg.warm_start is not None:
            try:
                warm_start(learner, cfg.warm_start)
            except (ValueError, OSError):
                if state is None:  # a run that goes on needs it only to show what was before
                    raise
        untrained = {key: value.clone() for key, value in learner.policy.state_dict().items()}
        run = RunFolder(folder)
        if state is None:
            write_config(cfg, HydraConfig.get().overrides.task, folder)
        else:
            robot = identity_of(learner.env.base_env.robot)
            checkpoint.check_fits(state, robot, learner.actor, folder)
            run.load_state_dict(state["run"])
            learner.load_state_dict(state)
    console = Console()
    if not train(learner, run, console):
        line = shell_line("train", f"resume={shown_path(folder)}")
        console.print(f"stopped; go on with: {line}", soft_wrap=True)
        raise SystemExit(130)
    if cfg.showcase:
        show(learner, untrained, folder, console)
    else:
        console.print(f"wrote {shown_path(folder)}", soft_wrap=True)


def run_training(cfg: DictConfig, folder: Path, console: Console) -> bool:
    """Trains a composed config in a folder, from its last checkpoint if there is one.

    Returns:
        Whether it came to its end; False if ctrl-c ended it early.
    """
    learner, run = Learner(cfg), RunFolder(folder)
    if (folder / "checkpoints" / "last.pt").exists():
        state = checkpoint.load(folder / "checkpoints" / "last.pt")
        run.load_state_dict(state["run"])
        learner.load_state_dict(state)
    elif cfg.warm_start is not None:
        warm_start(learner, cfg.warm_start)
    return train(learner, run, console)


@contextmanager
def removed_if_unused(folder: Path) -> Iterator[None]:
    """Removes the folder that hydra makes if nothing was put into it, error or not."""
    try:
        yield
    finally:
        with suppress(OSError):  # it holds something
            folder.rmdir()


def write_config(cfg: DictConfig, overrides: Sequence[str], folder: Path) -> None:
    """Writes what hydra itself would write before it is known whether the run is refused."""
    (folder / ".hydra").mkdir(parents=True, exist_ok=True)
    OmegaConf.save(cfg, folder / ".hydra" / "config.yaml")
    OmegaConf.save(OmegaConf.create(list(overrides)), folder / ".hydra" / "overrides.yaml")


def try_one_step(env_cfg: DictConfig) -> None:
    """Takes a step in two worlds of their own: terms and transforms that fail do so now."""
    instantiate(env_cfg, base_env={"num_envs": 2}).rollout(1)


def resumed_config(stored: str, overrides: Sequence[str], folder: Path) -> DictConfig:
    """The config of a run, with the values that were given to resume it.

    Raises:
        ValueError: on a value that cannot change in the middle of a run.
    """
    free = ("total_frames", "checkpoint_every", "showcase")
    for override in overrides:
        key = override.partition("=")[0]
        if key != "resume" and key.split(".")[0] not in free:
            raise ValueError(
                f"{key} must not be given with resume, it is that of {folder}; "
                f"only {', '.join(free)} may change."
            )
    given = [item for item in overrides if not item.startswith("resume=")]
    cfg = DictConfig(OmegaConf.create(stored))
    cfg.merge_with_dotlist(given)
    return cfg


def train(learner: Learner, run: "RunFolder", console: Console) -> bool:
    """The learning loop: collect, learn, write down; False if ctrl-c ended it early."""
    stop: list[int] = []  # the first ctrl-c lets the update end, so that it can be resumed exactly
    previous = signal.signal(
        signal.SIGINT,
        lambda number, _: stop.append(number) or signal.signal(number, previous),  # type: ignore[func-returns-value]
    )
    cfg, control_dt = learner.cfg, learner.env.base_env.control_dt
    total = max(1, -(-int(cfg.total_frames) // learner.frames_per_batch))
    with progress_bar(console) as bar, garbage_collector_of_new_things():
        task = bar.add_task("train", total=total, completed=learner.updates, note="")
        while learner.updates < total:
            times = [time.perf_counter()]
            batch = learner.collect()
            times.append(time.perf_counter())
            losses = learner.learn(batch)
            times.append(time.perf_counter())
            run.write(learner, batch_metrics(batch, learner.carrier, control_dt), losses, times)
            if learner.updates % cfg.checkpoint_every == 0 or learner.updates == total:
                run.save_last_and_best(learner)
            seconds = times[-1] - times[0]
            note = (
                f"{learner.frames / 1e6:.2f} M frames, {learner.frames_per_batch / seconds:.0f}/s, "
                f"return {run.last['episode_return']:.1f}, "
                f"episode {run.last['episode_seconds']:.1f} s"
            )
            bar.update(task, completed=learner.updates, note=note)
            if not console.is_terminal and learner.updates % 10 == 0:
                left = f"{(total - learner.updates) * seconds:.0f} s left"
                console.print(f"{learner.updates}/{total}: {note}, {left}", soft_wrap=True)
            if stop:
                run.save(learner, "last")
                return False
    signal.signal(signal.SIGINT, previous)
    return True


@contextmanager
def garbage_collector_of_new_things() -> Iterator[None]:
    """Spares the garbage collector what has been set up, which stays: it would visit all again."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def progress_bar(console: Console) -> Progress:
    """Updates, speed, return, episode length and time left."""
    return Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(bar_width=20),
        TextColumn("{task.completed}/{task.total}"),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
    )


class RunFolder:
    """The files of a run: metrics, timings, TensorBoard, checkpoints.

    Args:
        folder: the run folder.

    Raises:
        OSError: if it cannot be written.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(f"hydra.run.dir must be writable, {folder} is not.")
        self.board = TensorboardLogger(exp_name="tensorboard", log_dir=str(folder))
        self.last = {"episode_return": math.nan, "episode_seconds": math.nan}
        self.recent: list[tuple[float, float]] = []  # of the last updates, see save_last_and_best
        self.best: tuple[float, ...] = ()

    def write(
        self,
        learner: Learner,
        metrics: dict[str, float],
        losses: dict[str, float],
        times: list[float],
    ) -> None:
        """Adds the row of an update; what depends on the clock goes to its own file.

        Args:
            learner: after the update.
            metrics: of the batch.
            losses: of the last pass over it.
            times: when the update began, had its batch, and ended [s].
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
        for key, value in row.items():
            self.board.log_scalar(key, value, step=learner.frames)

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
        """Goes on from a checkpoint: rows written after it are dropped.

        Raises:
            ValueError: if another version of this program trained it.
        """
        if state.get("version") != VERSION:
            raise ValueError(
                f"{self.folder} must be a run of version {VERSION} to go on with it, got "
                f"{state.get('version')}; its policy can be read, its training begins anew."
            )
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


if __name__ == "__main__":
    start(main)
