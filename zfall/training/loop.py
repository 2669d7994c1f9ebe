"""The training loop: collect, learn, write down; ended early by ctrl-c, resumed exactly."""

import gc
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import TextColumn
from rich.table import Column

from zfall import checkpoint
from zfall.configs import compose_config
from zfall.terminal import Shortened, progress_bar
from zfall.training.exploration import exploration_of
from zfall.training.interrupts import Stopped, first_ctrl_c
from zfall.training.learner import Learner
from zfall.training.logging import quiet_threads
from zfall.training.metrics import batch_metrics
from zfall.training.own_draws import own_draws
from zfall.training.parts import with_own_worlds
from zfall.training.ranks import ALONE
from zfall.training.run_folder import RunFolder, check_version, full_disk_named, owned
from zfall.training.same_run import check_same_run
from zfall.training.stages import begin_stage, stage_reached
from zfall.trust import config_of_file, targets_of, trusting

Look = Callable[[Learner], None]

_OF_THE_CALL = ("resume", "trust")  # not of the run
_FREE = (
    "total_frames",
    "checkpoint_every",
    "showcase",
    "logger",
    "name",
    "launch",
    "device",
)  # may change


def free_overrides(overrides: Sequence[str]) -> list[str]:
    """Those overrides from the shell that may be given to a run which goes on."""
    return [override for override in overrides if _is_free(_key_of(override))]


def _key_of(override: str) -> str:
    return override.partition("=")[0].lstrip("+")


def _is_free(key: str) -> bool:
    parts = key.split(".")
    length = len(parts) == 3 and parts[0] == "stages" and parts[2] == "total_frames"
    return key in _OF_THE_CALL or parts[0] in _FREE or length


def resumed_config(
    stored: str, given: DictConfig, overrides: Sequence[str], folder: Path
) -> DictConfig:
    """The config of a run, with those of the ``given`` values that the shell overrides.

    Raises:
        ValueError: on a value that cannot change in the middle of a run.
    """
    keys = [_key_of(override) for override in overrides]
    for key in keys:
        if not _is_free(key):
            raise ValueError(
                f"{key} must not be given with resume, it is that of {folder}; "
                f"only {', '.join(_FREE)} may change."
            )
    cfg = DictConfig(OmegaConf.create(stored))
    # What a run from before these keys did; an experiment says what new ones do.
    for name, default in compose_config(["~experiment"]).items():
        if name not in cfg:
            cfg[name] = default
    for key in keys:
        if key not in _OF_THE_CALL:
            OmegaConf.update(cfg, key, OmegaConf.select(given, key), merge=False)
    return cfg


def run_training(cfg: DictConfig, folder: Path, console: Console) -> bool:
    """Trains a composed config in a folder, from its last checkpoint if there is one.

    Returns:
        Whether it came to its end; False if ctrl-c ended it early.

    Raises:
        ValueError: if another process trains there, the folder has a run of another config, or it
            asks for several ranks.
    """
    if cfg.launch.ranks not in (None, 1):
        raise ValueError(
            f"launch.ranks must be null or 1 for a training that a study or a program of yours "
            f"starts, got {cfg.launch.ranks}."
        )
    with full_disk_named(folder), owned(folder), quiet_threads():
        path = folder / "checkpoints" / "last.pt"
        state = None
        if path.exists():
            with trusting(targets_of(cfg)):  # all of them are built in any case
                state = checkpoint.load(path, checkpoint.TRAINING)
                before = {"whole_config": state["config"], **state["run"]}
                stored = config_of_file(before["whole_config"], path)
            check_version(state["run"], folder)
            check_same_run(stored, cfg, folder)
        stage = stage_reached(cfg, state)
        made = stage.make is not None
        learner = None if made else begin_stage(stage, folder, goes_on=state is not None)
        run = RunFolder(folder, cfg)
        if state is not None and learner is not None:
            with checkpoint.reading(path):
                notes = learner.load_state_dict(with_own_worlds(state, folder, ALONE))
                notes += run.load_state_dict(state["run"])
            for line in notes:
                console.print(line, soft_wrap=True)
        with suppress(Stopped):
            train_stages(learner, run, console)
            return True
    return False


def train_stages(
    learner: Learner | None, run: RunFolder, console: Console, look: Look | None = None
) -> Learner | None:
    """Trains, or makes, the stage at hand and those after it.

    Args:
        learner: of the stage at hand; None if that makes something in place of training.
        run: its folder.
        console: where progress is shown.
        look: is called with the learner every ``showcase.every`` updates.

    Returns:
        The learner of the last stage that trained; None if none did.

    Raises:
        Stopped: if ctrl-c ended it early.
    """
    while True:
        if run.stage.make is not None:
            run.make_stage(console)
        elif learner is not None and not train(learner, run, console, look):
            raise Stopped
        if run.at_last_stage:
            return learner
        learner = run.next_stage(learner)


def number_of_updates(learner: Learner) -> int:
    """Updates until ``total_frames``, at least one."""
    return max(1, math.ceil(learner.cfg.total_frames / learner.frames_per_batch))


def train(learner: Learner, run: RunFolder, console: Console, look: Look | None = None) -> bool:
    """The learning loop of a stage: collect, learn, write down; False if ctrl-c ended it early."""
    cfg, control_dt = learner.cfg, learner.env.base_env.control_dt
    total, every = number_of_updates(learner), (cfg.showcase or {}).get("every")
    looks = range(every, total, every) if every else ()
    counted = TextColumn("{task.completed}/{task.total}", table_column=Column(no_wrap=True))
    columns = (counted, Shortened("{task.fields[note]}"))
    with (
        progress_bar(console, *columns) as bar,
        garbage_collector_of_new_things(),
        first_ctrl_c() as stop,
    ):
        task = bar.add_task(
            run.stage.name or "train", total=total, completed=learner.updates, note=""
        )
        while learner.updates < total:
            times = [time.perf_counter()]
            batch = learner.collect()
            times.append(time.perf_counter())
            losses = learner.learn(batch)
            times.append(time.perf_counter())
            metrics = batch_metrics(batch, learner.carrier, control_dt, learner.ranks)
            learner.ranks.check_same(learner.parameters)
            figures = exploration_of(learner.actor, batch) if run.loggers else {}
            run.write(learner, metrics, losses, times, figures)
            if learner.updates % cfg.checkpoint_every == 0 or learner.updates in (1, total):
                run.save_last_and_best(learner)
            if look and learner.updates in looks:
                bar.update(task, note="a look at the policy so far")
                with own_draws():  # which training does not notice
                    look(learner)
            seconds = times[-1] - times[0]
            note = (
                f"return {run.last['episode_return']:.1f}, "
                f"episode {run.last['episode_seconds']:.1f} s, "
                f"{learner.frames_per_batch / seconds:.0f}/s, {learner.frames / 1e6:.2f} M frames"
            )
            bar.update(task, completed=learner.updates, note=note)
            if not console.is_terminal and learner.updates % 10 == 0:
                left = f"{(total - learner.updates) * seconds:.0f} s left"
                of = f"{run.stage.name} " if run.stage.name else ""
                console.print(f"{of}{learner.updates}/{total}: {note}, {left}", soft_wrap=True)
            if learner.ranks.any(stop.is_set()) and not (
                learner.updates == total and run.at_last_stage
            ):
                run.save(learner, "last")
                return False
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
