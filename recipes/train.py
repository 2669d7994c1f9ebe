"""Trains a policy and shows what it can do: ``python -m recipes.train experiment=quickstart``."""

import gc
import math
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from types import FrameType

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from recipes.config import check_config
from recipes.learner import Learner
from recipes.metrics import batch_metrics
from recipes.one_line import one_line_errors, shell_line, shown_path, start
from recipes.run_folder import RunFolder, check_version, removed_if_unused, write_config
from recipes.showcase import show
from recipes.tested import check_holds_run
from recipes.warm_start import warm_start
from zfall import checkpoint
from zfall.envs.model import identity_of


@hydra.main(version_base=None, config_path=".", config_name="train")
def main(cfg: DictConfig) -> None:
    """Trains until ``total_frames``; ctrl-c ends it early, with a checkpoint to resume from."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors(), removed_if_unused(folder):
        check_config(cfg)
        state = None
        if cfg.resume is not None:
            folder = Path(cfg.resume)
            check_holds_run(folder, "resume")
            state = checkpoint.load(folder / "checkpoints" / "last.pt")
            check_version(state["run"], folder)
            cfg = resumed_config(state["config"], cfg, HydraConfig.get().overrides.task, folder)
        elif (folder / "metrics.csv").exists():
            resumable = (folder / "checkpoints" / "last.pt").exists()
            repair = f"resume={shown_path(folder)} goes on with it" if resumable else "remove it"
            raise ValueError(
                f"hydra.run.dir must be a folder without a run, {folder} holds one"
                f"{'' if resumable else ' without a checkpoint'}; {repair}."
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
        if state is not None:
            robot = identity_of(learner.env.base_env.robot)
            checkpoint.check_fits(state, robot, learner.actor, folder)
            if number_of_updates(learner) < state["updates"]:
                raise ValueError(
                    f"total_frames must not be less than the {state['frames']} that {folder} has "
                    f"behind it, got {cfg.total_frames}."
                )
            learner.load_state_dict(state)
        run = RunFolder(folder)
        if state is None:
            write_config(cfg, HydraConfig.get().overrides.task, folder)
        else:
            run.load_state_dict(state["run"])
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
        check_version(state["run"], folder)
        learner.load_state_dict(state)
        run.load_state_dict(state["run"])
    elif cfg.warm_start is not None:
        warm_start(learner, cfg.warm_start)
    return train(learner, run, console)


def try_one_step(env_cfg: DictConfig) -> None:
    """Takes a step in two worlds of their own: terms and transforms that fail do so now."""
    instantiate(env_cfg, base_env={"num_envs": 2}).rollout(1)


def resumed_config(
    stored: str, given: DictConfig, overrides: Sequence[str], folder: Path
) -> DictConfig:
    """The config of a run, with those of the ``given`` values that the shell overrides.

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
    cfg = DictConfig(OmegaConf.create(stored))
    for key in (override.partition("=")[0] for override in overrides):
        if key != "resume":
            OmegaConf.update(cfg, key, OmegaConf.select(given, key), merge=False)
    return cfg


def number_of_updates(learner: Learner) -> int:
    """Updates until ``total_frames``, at least one."""
    return max(1, math.ceil(learner.cfg.total_frames / learner.frames_per_batch))


def train(learner: Learner, run: RunFolder, console: Console) -> bool:
    """The learning loop: collect, learn, write down; False if ctrl-c ended it early."""
    cfg, control_dt = learner.cfg, learner.env.base_env.control_dt
    total = number_of_updates(learner)
    with progress_bar(console) as bar, garbage_collector_of_new_things(), first_ctrl_c() as stop:
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
            if stop.is_set() and learner.updates < total:
                run.save(learner, "last")
                return False
    return True


@contextmanager
def first_ctrl_c() -> Iterator[Event]:
    """Set by the first ctrl-c, which lets the update end, to be resumed exactly; not the second."""
    pressed = Event()

    def press(number: int, frame: FrameType | None) -> None:
        pressed.set()
        signal.signal(number, previous)

    previous = signal.signal(signal.SIGINT, press)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, previous)


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


if __name__ == "__main__":
    start(main)
