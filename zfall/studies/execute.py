"""A run of a study: trained, tested, written down."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from filelock import FileLock
from omegaconf import DictConfig
from rich.console import Console

from zfall import checkpoint
from zfall.errors import in_one_line
from zfall.evaluation.candidate import Candidate
from zfall.evaluation.kinds import kind_of
from zfall.evaluation.plots.curves import POINTS
from zfall.evaluation.run import trials_of
from zfall.policies import Policy, load_policy
from zfall.studies.plan import Run, Test, battery_of, in_test, shown, training_size_of
from zfall.studies.store import Store
from zfall.training.loop import run_training
from zfall.training.run_folder import VERSION
from zfall.trust import targets_of, trusting

if TYPE_CHECKING:
    from zfall.studies.study import Study


def execute(study: "Study", run: Run, store: Store) -> None:
    """Trains one run, or goes on with it, tests it, and writes its figures."""
    missing = store.unfinished(run)  # others may be there of a study that shares it
    if not missing:
        return
    try:
        for cfg in reversed(run.trainings):
            train(cfg, store.run_folder(cfg))
    except Exception as error:
        for test in missing:
            _mark_failed(run, test, error, store)
        return
    folder = store.run_folder(run.cfg)
    for test in missing:
        who: dict[str, Any] = {"study": study.name, "row": run.row, "seed": run.seed}
        who |= {"test": test.title} if test.title else {}
        try:
            figures = figures_of(study, run, test, store)
            store.write(test, who, figures, learning_curve(folder))
        except Exception as error:
            _mark_failed(run, test, error, store)


def _mark_failed(run: Run, test: Test, error: Exception, store: Store) -> None:
    store.mark_failed(test, error)
    print(f"{shown(run, test)} failed: {in_one_line(error)}")


def train(cfg: DictConfig, folder: Path) -> None:
    """Trains in a folder, or goes on there; a process that wants the same waits.

    What another version of this program began is begun anew.

    Raises:
        SystemExit: if ctrl-c ended it.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    last = folder / "checkpoints" / "last.pt"
    with FileLock(folder.with_suffix(".lock")), trusting(targets_of(cfg)):
        if (
            not last.exists()
            or checkpoint.load(last, {"run": Mapping})["run"].get("version") != VERSION
        ):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        if not run_training(cfg, folder, Console(quiet=True)):
            raise SystemExit(130)


def figures_of(study: "Study", run: Run, test: Test, store: Store) -> dict[str, float]:
    """Figures of a run's policy in the world of a test, and of its training.

    ``frames_per_s`` is control steps/s of the whole training, collecting and learning.
    """
    battery = battery_of(study)
    policy = _policy_of(run.cfg, store)
    actor = policy.actor
    if run.tested_with is not None:
        others = [_policy_of(cfg, store) for cfg in run.others]
        actor = run.tested_with.actor(policy, others)
    trials = trials_of(battery, Candidate(run.row, in_test(test, policy.config.env), actor))
    folder = store.run_folder(run.cfg)
    timing = pd.read_csv(folder / "timing.csv")
    frames = int(pd.read_csv(folder / "metrics.csv")["frames"].iloc[-1])
    speed = frames / (timing["collect_s"] + timing["learn_s"]).sum()
    own = kind_of(battery).study_row(battery, trials, training_size_of(study, battery))
    return own | {"frames_per_s": float(speed), "frames": frames}


def _policy_of(cfg: DictConfig, store: Store) -> Policy:
    """What a training of the study gave; it may name what the study's own config names."""
    return load_policy(store.run_folder(cfg), trust=targets_of(cfg))


def learning_curve(folder: Path) -> pd.DataFrame:
    """Return and length of the episodes of a training over its frames, in a few points."""
    metrics = pd.read_csv(folder / "metrics.csv")
    bins = (metrics.index * POINTS // len(metrics)).to_numpy()
    return metrics.groupby(bins)[["frames", "episode_return", "episode_seconds"]].mean()
