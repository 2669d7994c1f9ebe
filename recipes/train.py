"""Trains a policy and shows what it can do: ``python -m recipes.train experiment=quickstart``."""

import csv
import os
import time
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torchrl.record import TensorboardLogger

from recipes.learner import Learner, batch_metrics
from recipes.one_line import check_keys, one_line_errors
from recipes.showcase import show
from zfall import checkpoint

KEYS = {
    *("seed", "num_envs", "total_frames", "rollout_steps", "epochs", "minibatches"),
    *("max_grad_norm", "resume", "checkpoint_every", "env", "actor", "critic", "loss"),
    *("optimizer", "scheduler", "showcase", "experiment"),
}


@hydra.main(version_base=None, config_path=".", config_name="train")
def main(cfg: DictConfig) -> None:
    """Trains until ``total_frames``; ctrl-c ends it early, with a checkpoint to resume from."""
    with one_line_errors():
        check_keys(cfg, KEYS)
        folder = Path(HydraConfig.get().runtime.output_dir)
        learner = Learner(cfg)
        if cfg.resume is not None:
            resume(learner, Path(cfg.resume))
        run = RunFolder(folder)
    console = Console()
    untrained = {key: value.clone() for key, value in learner.actor.state_dict().items()}
    try:
        train(learner, run, console)
    except KeyboardInterrupt:
        run.save(learner, "last")
        console.print(f"stopped; go on with: python -m recipes.train resume={folder}")
        raise SystemExit(130) from None
    show(learner, untrained, folder, console)


def resume(learner: Learner, folder: Path) -> None:
    """Puts the learner where the run in ``folder`` stood.

    Raises:
        ValueError: if its checkpoint belongs to another robot, actor or env.
    """
    state = checkpoint.load(folder / "checkpoints" / "last.pt")
    checkpoint.check_fits(state, learner.env.base_env.robot.name, learner.actor, folder)
    learner.load_state_dict(state)


def train(learner: Learner, run: "RunFolder", console: Console) -> None:
    """The learning loop: collect, learn, write down."""
    cfg, control_dt = learner.cfg, learner.env.base_env.control_dt
    total = max(1, -(-int(cfg.total_frames) // learner.frames_per_batch))
    best = -float("inf")
    recent: list[float] = []
    with progress_bar(console) as bar:
        task = bar.add_task("train", total=total, completed=learner.updates, note="")
        while learner.updates < total:
            began = time.perf_counter()
            batch = learner.collect()
            collected = time.perf_counter()
            losses = learner.learn(batch)
            ended = time.perf_counter()
            metrics = batch_metrics(batch, control_dt)
            run.write(learner, metrics, losses, began, collected, ended)
            recent = [*recent, metrics["reward"]][-10:]
            if learner.updates % cfg.checkpoint_every == 0 or learner.updates == total:
                run.save(learner, "last")
                if sum(recent) / len(recent) > best:
                    best = sum(recent) / len(recent)
                    run.save(learner, "best")
            speed = learner.frames_per_batch / (ended - began)
            episodes = f"return {run.last['episode_return']:6.2f}  episode {run.last['episode_seconds']:5.2f} s"
            note = f"{learner.frames / 1e6:5.2f} M frames  {speed:5.0f} frames/s  {episodes}"
            bar.update(task, completed=learner.updates, note=note)
            if not console.is_terminal and learner.updates % 10 == 0:
                left = (total - learner.updates) * (ended - began)
                console.print(f"{learner.updates}/{total}  {note}  {left:.0f} s left")


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
        self.last: dict[str, float] = {"episode_return": float("nan"), "episode_seconds": float("nan")}

    def write(
        self,
        learner: Learner,
        metrics: dict[str, float],
        losses: dict[str, float],
        began: float,
        collected: float,
        ended: float,
    ) -> None:
        """Adds the row of an update; what depends on the clock goes to its own file."""
        self.last |= {key: metrics[key] for key in self.last if key in metrics}
        row = {"update": learner.updates, "frames": learner.frames, **self.last, **metrics}
        row["kl"] = losses["kl_approx"]
        row["learning_rate"] = learner.optimizer.param_groups[0]["lr"]
        row |= {f"loss/{k.removeprefix('loss_')}": v for k, v in losses.items() if k != "kl_approx"}
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

    def save(self, learner: Learner, name: str) -> None:
        """Writes ``checkpoints/NAME.pt``."""
        checkpoint.save(self.folder / "checkpoints" / f"{name}.pt", learner.state_dict())


def append_row(path: Path, row: dict[str, Any]) -> None:
    """Adds a row to a csv file, with a header if it is the first."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(row))
        if new:
            writer.writeheader()
        writer.writerow(row)


if __name__ == "__main__":
    main()
