"""How a training begins, or goes on: everything is checked before anything is written."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from zfall import checkpoint
from zfall.commands import shown_path
from zfall.simulation.model import identity_of
from zfall.training.begun import BEGUN, load_begun, write_begun
from zfall.training.learner import Learner
from zfall.training.loop import free_overrides, number_of_updates, resumed_config
from zfall.training.parts import with_own_worlds
from zfall.training.ranks import Ranks
from zfall.training.run_folder import (
    VERSION,
    RunFolder,
    check_version,
    holds_run,
    write_config,
)
from zfall.training.same_run import AUTO, check_same_run
from zfall.training.stages import (
    begin_stage,
    check_lengths,
    check_stages,
    stage_reached,
    with_files,
)
from zfall.training.trial_step import try_one_step
from zfall.trust import config_of_file, targets_of, trusting


def begin(
    folder: Path, cfg: DictConfig, overrides: Sequence[str], console: Console, ranks: Ranks
) -> tuple[Learner | None, RunFolder]:
    """All that training takes, nothing written before all is checked.

    There is no learner where the stage at hand makes something in place of training.

    Args:
        folder: of the run, which is ours alone.
        cfg: as composed.
        overrides: from the shell.
        console: shows what was repaired.
        ranks: the processes that train it.

    Raises:
        ValueError: on a config or a checkpoint of which no training can be made.
    """
    state, notes, path = None, list[str](), folder / "checkpoints" / "last.pt"
    if cfg.resume == AUTO and not (path.exists() or (folder / BEGUN).exists()):
        cfg.resume = None
        _forget_figures(folder)
    goes_on = cfg.resume is not None
    if goes_on:
        if path.exists():
            state = checkpoint.load(path, checkpoint.TRAINING)
            before = {"whole_config": state["config"], **state["run"]}
        else:
            before = load_begun(folder)
            _forget_figures(folder)
        check_version(before, folder)
        own = cfg.resume == AUTO
        with trusting(targets_of(cfg) if own else []):
            config = config_of_file(before["whole_config"], path)  # before any of it is built
        if own:
            check_same_run(config, cfg, folder)
            overrides = free_overrides(overrides)
        stored = OmegaConf.to_yaml(config)
        check_lengths(stored, overrides, before.get("stage", 0))
        cfg = resumed_config(stored, cfg, overrides, folder)
    elif holds_run(folder):
        resumable = path.exists() or (folder / BEGUN).exists()
        repair = f"resume={shown_path(folder)} goes on with it" if resumable else "remove it"
        raise ValueError(
            f"hydra.run.dir must be a folder without a run, {folder} holds one"
            f"{'' if resumable else ' without a checkpoint'}; {repair}."
        )
    else:
        check_lengths(OmegaConf.to_yaml(cfg), overrides)
    with trusting(targets_of(cfg)):  # what is trained must be readable, too
        config_of_file(OmegaConf.to_yaml(cfg, resolve=True), folder)
        if not goes_on:
            check_stages(cfg, ranks)
    with checkpoint.reading(path):
        stage = stage_reached(cfg, state)
    learner = None
    if stage.make is None:
        try_one_step(with_files(stage, folder).env)
        learner = begin_stage(stage, folder, ranks, goes_on=goes_on)
    if state is not None and learner is not None:
        robot = identity_of(learner.env.base_env.robot)
        checkpoint.check_fits(state, robot, learner.actor, folder)
        if number_of_updates(learner) < state["updates"]:
            raise ValueError(
                f"total_frames must not be less than the {state['frames']} that {folder} has "
                f"behind it, got {stage.config.total_frames}."
            )
        with checkpoint.reading(path):
            notes = learner.load_state_dict(with_own_worlds(state, folder, ranks))
    ranks.gathered(None)  # all have read what is there
    run = RunFolder(folder, cfg, ranks)
    if not goes_on and ranks.leads:
        write_config(cfg, overrides, folder)
        if stage.make is not None:
            write_begun(cfg, folder, VERSION)
    elif state is not None:
        with checkpoint.reading(path):
            notes += run.load_state_dict(state["run"])
        for line in notes:
            console.print(line, soft_wrap=True)
    return learner, run


def _forget_figures(folder: Path) -> None:
    """Removes those of a run that was cut before its first checkpoint."""
    for name in ("metrics.csv", "timing.csv"):
        (folder / name).unlink(missing_ok=True)
