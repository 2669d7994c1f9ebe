"""Trains a policy and shows what it can do: ``python -m recipes.train experiment=quickstart``."""

from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import remove_if_empty, shell_line, shown_path
from zfall.errors import SPOKEN
from zfall.training.keys import TrainKeys
from zfall.trust import trusting

from .shell import check_recipe, one_line_errors, start

if TYPE_CHECKING:
    from zfall.training.learner import Learner


@hydra.main(version_base=None, config_path=".", config_name="train")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Trains until ``total_frames``; ctrl-c ends it early, with a checkpoint to resume from."""
    made = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, TrainKeys)
    from zfall.policies.load import check_holds_run
    from zfall.training.begin import AUTO
    from zfall.training.checks import check_config
    from zfall.training.logging import quiet_threads
    from zfall.training.run_folder import full_disk_named, owned, removed_if_unused

    with one_line_errors(SPOKEN), removed_if_unused(made), trusting(cfg.trust):
        with one_line_errors():
            check_config(cfg)
        if cfg.resume in (None, AUTO):
            folder = made
        else:
            folder = Path(cfg.resume)
            check_holds_run(folder, "resume")
            remove_if_empty(made)  # it is not needed
        with full_disk_named(folder), owned(folder), quiet_threads():
            train_in(folder, cfg)


def train_in(folder: Path, cfg: DictConfig) -> None:
    """Trains in a folder that is ours, or goes on there, and shows what came of it."""
    from rich.console import Console

    from zfall.evaluation.showcase import battery_of, show
    from zfall.training.begin import begin
    from zfall.training.loop import train_stages
    from zfall.training.run_folder import full_disk_named

    console = Console()
    with one_line_errors(), full_disk_named(folder):
        battery_of(cfg)  # before hours are spent
        learner, run = begin(folder, cfg, HydraConfig.get().overrides.task, console)

    def look(learner: "Learner") -> None:
        show(learner.cfg, learner.policy, learner.beginning, folder, Console(quiet=True))

    trained = train_stages(learner, run, console, look)
    if trained is None:
        line = shell_line("train", f"resume={shown_path(folder)}")
        console.print(f"stopped; go on with: {line}", soft_wrap=True)
        raise SystemExit(130)
    showcase = trained.cfg.showcase
    if showcase:
        show(trained.cfg, trained.policy, trained.beginning, folder, console)
        if showcase.video and (folder / "video.mp4").exists():
            for line in run.loggers.log_film(folder / "video.mp4", run.frames(trained)):
                console.print(line, soft_wrap=True)
    else:
        console.print(f"wrote {shown_path(folder)}", soft_wrap=True)


if __name__ == "__main__":
    start(main)
