"""Runs a study and makes its table: ``python -m recipes.ablate study=termination``.

A study is a yaml: a base, rows of overrides, seeds, a battery, a budget. What is finished is not
run again, what was cut goes on, a run that fails is marked and the others go on.
"""

import hashlib
import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import Any

import hydra
import pandas as pd
from hydra import compose
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from recipes.one_line import check_keys, in_one_line, one_line_errors, start
from recipes.tested import keep, load_run
from recipes.train import run_training
from zfall.evaluation.ablation import FIGURES, as_frame, as_latex, as_markdown, study_table
from zfall.evaluation.battery import run_battery
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.plots import learning_bands
from zfall.evaluation.plots.curves import POINTS
from zfall.evaluation.statistics import summarize

KEYS = {"study", "results", "runs", "keep", "rebuild", "launcher", "jobs"}
STUDY = {"name", "base", "rows", "seeds", "row_seeds", "total_frames", "battery", "training_size"}


@dataclass(frozen=True)
class Run:
    """One row with one seed.

    Args:
        row: its name.
        seed: of the training.
        cfg: of ``recipes.train``, as it is run.
        name: tells its config and battery from all others, whatever study they belong to.
    """

    row: str
    seed: int
    cfg: DictConfig
    name: str


@hydra.main(version_base=None, config_path=".", config_name="ablate")
def main(cfg: DictConfig) -> None:
    """Runs what is missing and writes ``NAME.{md,csv,tex,png,pdf}`` into ``results``."""
    with one_line_errors():
        check_keys(cfg, KEYS)
        check_keys(cfg.study, STUDY, "study.")
        runs = plan(cfg.study, list(cfg.keep))
    if cfg.jobs is not None:  # in a launcher's process
        execute(runs[int(cfg.jobs)], cfg)
        return
    results = Path(cfg.results)
    (results / "runs").mkdir(parents=True, exist_ok=True)
    todo = [i for i, run in enumerate(runs) if not result_file(results, run).exists()]
    if todo and not cfg.rebuild:
        launch(todo, runs, cfg)
    write_tables(runs, cfg)


def plan(study: DictConfig, keep_on: Sequence[str] = ()) -> list[Run]:
    """All runs of a study; every config is composed now, so that a bad one fails before any runs.

    Raises:
        ValueError: if two rows are the same.
    """
    runs = []
    for row, overrides in study.rows.items():
        for seed in OmegaConf.select(study, "row_seeds", default={}).get(row, study.seeds):
            given = [*study.base, *overrides, f"seed={seed}", f"total_frames={study.total_frames}"]
            cfg = compose("train", overrides=[*given, "showcase=null"])
            wanted = {
                "config": OmegaConf.to_yaml(cfg, resolve=True),
                "battery": OmegaConf.to_container(study.battery),
                "training_size": study.training_size,
                "keep": list(keep_on),
            }
            digest = hashlib.sha256(json.dumps(wanted, sort_keys=True).encode()).hexdigest()
            runs.append(Run(str(row), int(seed), cfg, digest[:12]))
    same = {run.name: run.row for run in reversed(runs)}
    for run in runs:
        if same[run.name] != run.row:
            raise ValueError(f"rows must differ, {run.row} and {same[run.name]} are the same.")
    return runs


def launch(todo: list[int], runs: list[Run], cfg: DictConfig) -> None:
    """Runs in this process, or with another launcher of hydra; one bar shows the whole study."""
    columns = (TextColumn("{task.completed}/{task.total} M frames"), TimeElapsedColumn())
    left = (TextColumn("left"), TimeRemainingColumn())
    title = TextColumn(f"study {cfg.study.name}")
    with Progress(title, BarColumn(), *columns, *left, console=Console()) as bar:
        done = threading.Event()
        follower = threading.Thread(target=follow, args=(bar, runs, cfg, done))
        follower.start()
        try:
            if cfg.launcher == "basic":
                for number in todo:
                    execute(runs[number], cfg)
            else:
                submit(todo, cfg)
        finally:
            done.set()
            follower.join()


def follow(bar: Progress, runs: list[Run], cfg: DictConfig, done: threading.Event) -> None:
    """Keeps the bar up to date, from the files of the runs."""
    task = bar.add_task(
        "study", total=round(sum(int(run.cfg.total_frames) for run in runs) / 1e6, 2)
    )
    while not done.wait(2.0):
        frames = sum(frames_done(run, cfg) for run in runs)
        bar.update(task, completed=round(frames / 1e6, 2))


def submit(todo: list[int], cfg: DictConfig) -> None:
    """Hands the runs to a launcher: this program again, as a sweep over their numbers."""
    study = HydraConfig.get().runtime.choices["study"]
    command = [sys.executable, "-m", "recipes.ablate", "-m", f"study={study}"]
    command += [f"jobs={','.join(map(str, todo))}", f"results={cfg.results}", f"runs={cfg.runs}"]
    command.append(f"keep=[{','.join(cfg.keep)}]")
    command.append(f"hydra/launcher={cfg.launcher}")
    for source in HydraConfig.get().runtime.config_sources:
        if source.provider == "command-line":  # a folder of the user's own studies
            command.append(f"--config-dir={source.path}")
    Path(cfg.runs).mkdir(parents=True, exist_ok=True)
    with (Path(cfg.runs) / f"{cfg.study.name}.log").open("a") as log:
        subprocess.run(command, stdout=log, stderr=log, check=False)


def frames_done(run: Run, cfg: DictConfig) -> int:
    """Frames of a run so far."""
    if result_file(Path(cfg.results), run).exists():
        return int(run.cfg.total_frames)
    path = Path(cfg.runs) / run.name / "metrics.csv"
    lines = path.read_text().splitlines() if path.exists() else []
    return int(lines[-1].split(",")[1]) if len(lines) > 1 else 0


def result_file(results: Path, run: Run) -> Path:
    """Where the figures of a finished run lie."""
    return results / "runs" / f"{run.name}.csv"


def execute(run: Run, cfg: DictConfig) -> None:
    """Trains one run, or goes on with it, tests it, and writes its figures."""
    folder, results = Path(cfg.runs) / run.name, Path(cfg.results)
    if result_file(results, run).exists():  # of a study that shares it
        return
    failed = folder / "failed.txt"
    try:
        if not (folder / "checkpoints" / "last.pt").exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        failed.unlink(missing_ok=True)
        if not run_training(run.cfg, folder, Console(quiet=True)):
            raise SystemExit(130)
        figures = test(run, cfg, folder)
    except Exception as error:
        folder.mkdir(parents=True, exist_ok=True)
        failed.write_text(in_one_line(error))
        print(f"{run.row}, seed {run.seed}, failed: {in_one_line(error)}")
        return
    metrics = pd.read_csv(folder / "metrics.csv")
    bins = (metrics.index * POINTS // len(metrics)).to_numpy()
    curve = metrics.groupby(bins)[["frames", "episode_return", "episode_seconds"]].mean()
    curve.to_csv(results / "runs" / f"{run.name}_curve.csv", index=False)
    line = pd.DataFrame([{"row": run.row, "seed": run.seed, "study": cfg.study.name, **figures}])
    temporary = result_file(results, run).with_suffix(".tmp")
    line.to_csv(temporary, index=False)
    temporary.replace(result_file(results, run))


def test(run: Run, cfg: DictConfig, folder: Path) -> dict[str, float]:
    """Figures of the policy of a run folder, in the env it was trained in."""
    options: dict[str, Any] = dict(OmegaConf.to_container(cfg.study.battery))  # type: ignore[arg-type]
    battery = load_battery(options.pop("name"), **options)
    loading = OmegaConf.create({"env": None, "change": [], "checkpoint": "last"})
    env_cfg, actor = load_run(loading, str(folder))
    env_cfg = keep(env_cfg, [name for name in cfg.keep if name in env_cfg.training_only])
    trials = run_battery(battery, env_cfg, actor)
    summary = summarize(battery, trials)
    timing = pd.read_csv(folder / "timing.csv")
    mild = trials[trials["impulse"] == trials["impulse"][trials["impulse"] > 0].min()]
    frames = pd.read_csv(folder / "metrics.csv")["frames"].iloc[-1]
    return {
        "i50_mean": summary["i50_mean"],
        "i50_min": summary["i50_min"],
        "success": summary["success"][cfg.study.training_size],
        "target_smoothness": 1e3 * summary["target_smoothness"],
        "joint_torque_rms": float(mild["joint_torque_rms"].mean()),
        "control_falls": summary["control_falls"],
        "frames_per_s": float(frames / (timing["collect_s"] + timing["learn_s"]).sum()),
        "frames": int(frames),
    }


def write_tables(runs: list[Run], cfg: DictConfig) -> None:
    """The study's table and learning curves, from the files of finished runs alone."""
    results, name = Path(cfg.results), cfg.study.name
    lines: dict[str, list[pd.DataFrame]] = {str(row): [] for row in cfg.study.rows}
    curves: dict[str, list[pd.DataFrame]] = {row: [] for row in lines}
    missing: dict[str, str] = {}
    for run in runs:
        path = result_file(results, run)
        if path.exists():
            lines[run.row].append(pd.read_csv(path).assign(seed=run.seed))
            curves[run.row].append(pd.read_csv(path.with_name(f"{run.name}_curve.csv")))
        else:
            why = Path(cfg.runs) / run.name / "failed.txt"
            text = f"failed: {shorten(why.read_text(), 100)}" if why.exists() else "not run"
            missing[f"{run.row}, seed {run.seed}"] = text
    empty = pd.DataFrame(columns=["seed", *FIGURES])
    frames: Mapping[str, pd.DataFrame] = {
        row: pd.concat(parts, ignore_index=True) if parts else empty for row, parts in lines.items()
    }
    table = study_table(frames)
    text = as_markdown(table, missing)
    (results / f"{name}.md").write_text(text)
    (results / f"{name}.tex").write_text(as_latex(table, missing))
    as_frame(table).to_csv(results / f"{name}.csv", index=False)
    drawn = {row: parts for row, parts in curves.items() if parts}
    if drawn:
        for ending in ("png", "pdf"):
            learning_bands(drawn, results / f"{name}.{ending}", title=name)
    print(text)
    print(f"wrote {results}/{name}.md, .csv, .tex, .png, .pdf")


if __name__ == "__main__":
    start(main)
