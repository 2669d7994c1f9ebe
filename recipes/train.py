"""Trains a policy and shows what it can do: ``python -m recipes.train experiment=quickstart``."""

from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console
from torch import Tensor

from zfall import checkpoint
from zfall.commands import remove_if_empty, shell_line, shown_path
from zfall.evaluation.showcase import show
from zfall.policies.load import check_holds_run
from zfall.simulation.model import identity_of
from zfall.training.checks import check_config
from zfall.training.learner import Learner
from zfall.training.logging import quiet_threads
from zfall.training.loop import number_of_updates, resumed_config, train, try_one_step
from zfall.training.run_folder import (
    RunFolder,
    check_version,
    full_disk_named,
    holds_run,
    owned,
    removed_if_unused,
    write_config,
)
from zfall.training.warm_start import warm_start
from zfall.trust import trusting

from .shell import one_line_errors, start


@hydra.main(version_base=None, config_path=".", config_name="train")
def main(cfg: DictConfig) -> None:
    """Trains until ``total_frames``; ctrl-c ends it early, with a checkpoint to resume from."""
    made = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors(), removed_if_unused(made), trusting(cfg.trust):
        check_config(cfg)
        if cfg.resume is None:
            folder = made
        else:
            folder = Path(cfg.resume)
            check_holds_run(folder, "resume")
            remove_if_empty(made)  # it is not needed
        with full_disk_named(folder), owned(folder), quiet_threads():
            train_in(folder, cfg, Console())


def train_in(folder: Path, cfg: DictConfig, console: Console) -> None:
    """Trains in a folder that is ours, or goes on there, and shows what came of it."""
    learner, run, untrained = begin(folder, cfg, console)
    if not train(learner, run, console):
        line = shell_line("train", f"resume={shown_path(folder)}")
        console.print(f"stopped; go on with: {line}", soft_wrap=True)
        raise SystemExit(130)
    showcase = learner.cfg.showcase
    if showcase:
        show(learner.cfg, learner.policy, untrained, folder, console)
        if showcase.video and (folder / "video.mp4").exists():
            for line in run.loggers.log_film(folder / "video.mp4", learner.frames):
                console.print(line, soft_wrap=True)
    else:
        console.print(f"wrote {shown_path(folder)}", soft_wrap=True)


def begin(
    folder: Path, cfg: DictConfig, console: Console
) -> tuple[Learner, RunFolder, dict[str, Tensor]]:
    """All that training takes, nothing written before all is checked; and the untrained weights."""
    overrides = HydraConfig.get().overrides.task
    state, path = None, folder / "checkpoints" / "last.pt"
    if cfg.resume is not None:
        state = checkpoint.load(path, checkpoint.TRAINING)
        check_version(state["run"], folder)
        cfg = resumed_config(state["config"], cfg, overrides, folder)
    elif holds_run(folder):
        resumable = path.exists()
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
        with checkpoint.reading(path):
            learner.load_state_dict(state)
    run = RunFolder(folder, cfg)
    if state is None:
        write_config(cfg, overrides, folder)
    else:
        with checkpoint.reading(path):
            notes = run.load_state_dict(state["run"])
        for line in notes:
            console.print(line, soft_wrap=True)
    return learner, run, untrained


if __name__ == "__main__":
    start(main)
