"""Trains a policy and shows what it can do: ``python -m recipes.train experiment=quickstart``."""

from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import remove_if_empty, shell_line, shown_path
from zfall.errors import SPOKEN
from zfall.training.keys import TrainKeys
from zfall.training.launch import again, is_launcher, one_voice, run_ranks
from zfall.trust import trusting

from .shell import check_recipe, one_line_errors, start

if TYPE_CHECKING:
    from zfall.training.learner import Learner
    from zfall.training.ranks import Ranks


@hydra.main(version_base=None, config_path=".", config_name="train")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Trains until ``total_frames``; ctrl-c ends it early, with a checkpoint to resume from."""
    made = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, TrainKeys)
    from zfall.policies.load import check_holds_run
    from zfall.training.checks import check_config
    from zfall.training.logging import quiet_threads
    from zfall.training.meeting import owned_by_all, ranks_of, shared_folder
    from zfall.training.run_folder import full_disk_named, removed_if_unused
    from zfall.training.same_run import AUTO

    with one_line_errors(SPOKEN), removed_if_unused(made), trusting(cfg.trust):
        with one_line_errors():
            check_config(cfg)
        if cfg.resume in (None, AUTO):
            folder = made
        else:
            folder = Path(cfg.resume)
            check_holds_run(folder, "resume")
            remove_if_empty(made)  # it is not needed
        if is_launcher(cfg.launch.ranks, cfg.num_envs if folder == made else 0):
            command = again(f"{__package__}.train", made if folder == made else None)
            raise SystemExit(run_ranks(command, cfg.launch.ranks, folder))
        with ranks_of(cfg) as ranks:
            folder = shared_folder(ranks, folder)
            with full_disk_named(folder), owned_by_all(folder, ranks), quiet_threads():
                train_in(folder, cfg, ranks)


def train_in(folder: Path, cfg: DictConfig, ranks: "Ranks") -> None:
    """Trains in a folder that is ours, or goes on there, and shows what came of it.

    Of several ranks the leading one speaks, writes and shows.
    """
    from rich.console import Console

    from zfall.evaluation.showcase import battery_of, show
    from zfall.training.begin import begin
    from zfall.training.interrupts import Stopped
    from zfall.training.loop import train_stages
    from zfall.training.run_folder import full_disk_named

    console = Console(quiet=not ranks.leads)
    with one_line_errors(), full_disk_named(folder):
        battery_of(cfg)  # before hours are spent
        learner, run = begin(folder, cfg, HydraConfig.get().overrides.task, console, ranks)

    def look(learner: "Learner") -> None:
        if ranks.leads:
            policy = learner.transfers.module_back(learner.policy)
            show(learner.cfg, policy, learner.beginning, folder, Console(quiet=True))
        ranks.wait()

    try:
        trained = train_stages(learner, run, console, look)
    except Stopped:
        line = shell_line("train", f"resume={shown_path(folder)}")
        console.print(f"stopped; go on with: {line}", soft_wrap=True)
        raise SystemExit(130) from None
    if run.stage.make is not None:
        console.print(f"wrote {shown_path(folder / run.stage.file)}", soft_wrap=True)
    showcase = trained.cfg.showcase if trained else None
    if trained and showcase and ranks.leads:
        policy = trained.transfers.module_back(trained.policy)
        show(trained.cfg, policy, trained.beginning, folder, console)
        if showcase.video and (folder / "video.mp4").exists():
            for line in run.loggers.log_film(folder / "video.mp4", run.frames(trained)):
                console.print(line, soft_wrap=True)
    else:
        console.print(f"wrote {shown_path(folder)}", soft_wrap=True)


if __name__ == "__main__":
    with one_voice():
        start(main)
