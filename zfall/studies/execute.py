"""The runs of a study: trained, tested, written down."""

import os
import shutil
from pathlib import Path

import pandas as pd
import torch
from filelock import FileLock
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from zfall import checkpoint
from zfall.errors import in_one_line
from zfall.evaluation.battery import run_battery
from zfall.evaluation.candidate import begins_kneeling, load_run
from zfall.evaluation.plots.curves import POINTS
from zfall.falling.switched import StillActor, SwitchedActor
from zfall.studies.plan import SCRIPT, Run, Test, battery_of, in_test, run_folder, shown
from zfall.studies.tables import kneel_figures, planar_figures
from zfall.training.loop import run_training
from zfall.training.run_folder import VERSION

LATEST = OmegaConf.create({"env": None, "change": [], "checkpoint": "last"})


def result_file(results: Path, test: Test) -> Path:
    """Where the figures of a finished run lie."""
    return results / "runs" / f"{test.name}.csv"


def failure_file(runs: Path, test: Test) -> Path:
    """Where it is written down why there are none."""
    return runs / f"{test.name}.failed"


def unfinished(run: Run, results: Path) -> list[Test]:
    """Tests of a run whose figures are not there."""
    return [test for test in run.tests if not result_file(results, test).exists()]


def execute(run: Run, cfg: DictConfig) -> None:
    """Trains one run, or goes on with it, tests it, and writes its figures."""
    runs = Path(cfg.runs)
    missing = unfinished(run, Path(cfg.results))  # others may be there of a study that shares it
    if not missing:
        return
    try:
        for each in reversed(run.trainings):
            train(each, run_folder(runs, each))
    except Exception as error:
        for test in missing:
            mark_failed(run, test, error, runs)
        return
    for test in missing:
        try:
            write(run, test, figures(run, test, cfg), cfg)
            failure_file(runs, test).unlink(missing_ok=True)
        except Exception as error:
            mark_failed(run, test, error, runs)


def mark_failed(run: Run, test: Test, error: Exception, runs: Path) -> None:
    """Writes down why a test has no figures."""
    runs.mkdir(parents=True, exist_ok=True)
    failure_file(runs, test).write_text(in_one_line(error))
    print(f"{shown(run, test)} failed: {in_one_line(error)}")


def train(cfg: DictConfig, folder: Path) -> None:
    """Trains in a folder, or goes on there; a process that wants the same waits.

    What another version of this program began is begun anew.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    last = folder / "checkpoints" / "last.pt"
    with FileLock(folder.with_suffix(".lock")):
        if not last.exists() or checkpoint.load(last)["run"].get("version") != VERSION:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        if not run_training(cfg, folder, Console(quiet=True)):
            raise SystemExit(130)


def figures(run: Run, test: Test, cfg: DictConfig) -> dict[str, float]:
    """Figures of a run's policy in the world of a test."""
    battery = battery_of(cfg.study)
    folder = run_folder(Path(cfg.runs), run.cfg)
    env_cfg, actor = tested(run, test, Path(cfg.runs))
    trials = run_battery(battery, env_cfg, actor)
    timing = pd.read_csv(folder / "timing.csv")
    frames = int(pd.read_csv(folder / "metrics.csv")["frames"].iloc[-1])
    size = f"{float(cfg.study.training_size):g}" if not battery.forces else ""
    own = kneel_figures(trials) if battery.forces else planar_figures(battery, trials, size)
    speed = frames / (timing["collect_s"] + timing["learn_s"]).sum()
    return own | {"frames_per_s": float(speed), "frames": frames}


def tested(run: Run, test: Test, runs: Path) -> tuple[DictConfig, torch.nn.Module]:
    """The world of a test with what the policy sees and does in it, and the policy."""
    own_cfg, actor = load_run(LATEST, str(run_folder(runs, run.cfg)))
    assert actor is not None  # a run folder holds a policy
    if run.beside is not None:
        role, other = run.beside
        second: torch.nn.Module | None
        if other == SCRIPT:
            size = instantiate(own_cfg, base_env={"num_envs": 1}).action_spec.shape[-1]
            other_cfg, second = own_cfg, StillActor(size)
        else:
            name = other if isinstance(other, str) else str(run_folder(runs, other))
            other_cfg, second = load_run(LATEST, name)
        recover, kneel = (actor, second) if role == "kneel" else (second, actor)
        begins = begins_kneeling(other_cfg if role == "kneel" else own_cfg)
        actor = SwitchedActor(recover, kneel, begins=begins)
    return in_test(test, own_cfg), actor


def write(run: Run, test: Test, values: dict[str, float], cfg: DictConfig) -> None:
    """Writes the figures of a finished run, and its learning curve in a few points."""
    folder = run_folder(Path(cfg.runs), run.cfg)
    path = result_file(Path(cfg.results), test)
    metrics = pd.read_csv(folder / "metrics.csv")
    bins = (metrics.index * POINTS // len(metrics)).to_numpy()
    curve = metrics.groupby(bins)[["frames", "episode_return", "episode_seconds"]].mean()
    curve.to_csv(path.with_name(f"{test.name}_curve.csv"), index=False)
    who = {"row": run.row, "seed": run.seed, "study": cfg.study.name}
    who |= {"test": test.title} if test.title else {}
    temporary = path.with_suffix(f".{os.getpid()}.tmp")  # another study may write the same
    pd.DataFrame([who | values]).to_csv(temporary, index=False)
    temporary.replace(path)


def frames_done(total: int, folder: Path) -> int:
    """Frames of a training so far, of those it is to have."""
    path = folder / "metrics.csv"
    lines = path.read_text().splitlines() if path.exists() else []
    return min(int(lines[-1].split(",")[1]), total) if len(lines) > 1 else 0
