"""Runs a study and makes its table: ``python -m recipes.ablate study=termination``.

A study is a yaml: a base, rows of overrides, seeds, a battery, a budget. What is finished is not
run again, what was cut goes on, a run that fails is marked and the others go on.
"""

import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from textwrap import shorten

import hydra
import pandas as pd
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from recipes.shell import one_line_errors, start
from zfall.errors import check_flags, check_keys
from zfall.evaluation.plots import learning_bands
from zfall.studies.execute import execute, failure_file, frames_done, result_file, unfinished
from zfall.studies.plan import STUDY, Run, Test, battery_of, plan, run_folder
from zfall.studies.tables import (
    KNEEL,
    PLANAR,
    Cell,
    as_frame,
    as_latex,
    as_markdown,
    study_table,
)

KEYS = {"study", "results", "runs", "rebuild", "launcher", "jobs"}


@hydra.main(version_base=None, config_path=".", config_name="ablate")
def main(cfg: DictConfig) -> None:
    """Runs what is missing and writes ``NAME.{md,csv,tex,png,pdf}`` into ``results``."""
    with one_line_errors():
        check_keys(cfg, KEYS)
        check_keys(cfg.study, STUDY, "study.")
        check_flags(cfg, ["rebuild"])
        for key in ("results", "runs"):
            if not isinstance(cfg[key], str):
                raise ValueError(f"{key} must be the name of a folder, got {cfg[key]}.")
        runs = plan(cfg.study)
    if cfg.jobs is not None:  # in a launcher's process
        execute(runs[int(cfg.jobs)], cfg)
        return
    results = Path(cfg.results)
    (results / "runs").mkdir(parents=True, exist_ok=True)
    todo = [i for i, run in enumerate(runs) if unfinished(run, results)]
    if todo and not cfg.rebuild:
        launch(todo, runs, cfg)
    write_tables(runs, cfg)


def launch(todo: list[int], runs: list[Run], cfg: DictConfig) -> None:
    """Runs in this process, or with another launcher of hydra; one bar shows the whole study."""
    columns = (TextColumn("{task.completed}/{task.total} M frames"), TimeElapsedColumn())
    left = (TextColumn("left"), TimeRemainingColumn())
    title = TextColumn(f"study {cfg.study.name}")
    with Progress(title, BarColumn(), *columns, *left, console=Console()) as bar:
        done = threading.Event()
        # Paths and numbers alone: a config that one thread copies cannot be read in another.
        folders = [[run_folder(Path(cfg.runs), each) for each in run.trainings] for run in runs]
        frames = {
            folder: int(each.total_frames)
            for run, own in zip(runs, folders, strict=True)
            for each, folder in zip(run.trainings, own, strict=True)
        }
        given = (bar, runs, folders, frames, Path(cfg.results), done)
        follower = threading.Thread(target=follow, args=given)
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


def follow(
    bar: Progress,
    runs: list[Run],
    folders: list[list[Path]],
    frames: Mapping[Path, int],
    results: Path,
    done: threading.Event,
) -> None:
    """Keeps the bar up to date, from the files of the runs.

    Args:
        folders: of the trainings of each run.
        frames: to be trained in each folder.
        done: ends it.
    """
    task = bar.add_task("study", total=round(sum(frames.values()) / 1e6, 2))
    while not done.wait(2.0):
        pairs = zip(runs, folders, strict=True)
        needed = {folder for run, own in pairs if unfinished(run, results) for folder in own}
        trained = sum(
            frames_done(total, folder) if folder in needed else total
            for folder, total in frames.items()
        )
        bar.update(task, completed=round(trained / 1e6, 2))


def submit(todo: list[int], cfg: DictConfig) -> None:
    """Hands the runs to a launcher: this program again, as a sweep over their numbers."""
    given = HydraConfig.get().overrides.task  # which study, and what of it was changed
    command = [sys.executable, "-m", "recipes.ablate", "-m", *given]
    command += [f"jobs={','.join(map(str, todo))}", f"hydra/launcher={cfg.launcher}"]
    for source in HydraConfig.get().runtime.config_sources:
        if source.provider == "command-line":  # a folder of the user's own studies
            command.append(f"--config-dir={source.path}")
    Path(cfg.runs).mkdir(parents=True, exist_ok=True)
    path = Path(cfg.runs) / f"{cfg.study.name}.log"
    with path.open("a") as log:
        code = subprocess.run(command, stdout=log, stderr=log, check=False).returncode
    if code:
        last = (path.read_text().strip().splitlines() or ["nothing"])[-1]
        print(f"error: launcher {cfg.launcher} failed ({path}): {last}", file=sys.stderr)


def write_tables(runs: list[Run], cfg: DictConfig) -> None:
    """The study's tables and learning curves, from the files of finished runs alone.

    One table for each test, its rows those of the study; of a study with one row, one table
    whose rows are the tests.
    """
    results, name = Path(cfg.results), cfg.study.name
    figures = KNEEL if battery_of(cfg.study).forces else PLANAR
    texts, sources, frames = [], [], []
    for title, cells in arranged(runs).items():
        lines: dict[str, list[pd.DataFrame]] = {row: [] for row, _, _ in cells}
        missing: dict[str, str] = {}
        for row, run, test in cells:
            path = result_file(results, test)
            if path.exists():
                lines[row].append(pd.read_csv(path).assign(seed=run.seed))
            else:
                missing[f"{row}, seed {run.seed}"] = why_missing(test, cfg)
        table = study_table(joined(lines, figures), figures)
        head, comment = (f"Tested: {title}\n\n", f"% tested: {title}\n") if title else ("", "")
        texts.append(head + as_markdown(table, missing, figures))
        sources.append(comment + as_latex(table, missing, figures))
        frames.append(table_lines(title, table))
    text = "\n".join(texts)
    (results / f"{name}.md").write_text(text)
    (results / f"{name}.tex").write_text("\n".join(sources))
    pd.concat(frames).to_csv(results / f"{name}.csv", index=False)
    write_curves(runs, cfg)
    print(text)
    print(f"wrote {results}/{name}.md, .csv, .tex, .png, .pdf")


def arranged(runs: list[Run]) -> dict[str, list[tuple[str, Run, Test]]]:
    """By title, the cells of each table: row, run and test."""
    one_row = len({run.row for run in runs}) == 1 and len(runs[0].tests) > 1
    tables: dict[str, list[tuple[str, Run, Test]]] = {}
    for number in range(len(runs[0].tests)):
        for run in runs:
            test = run.tests[number]
            title, row = ("", test.title) if one_row else (test.title, run.row)
            tables.setdefault(title, []).append((row, run, test))
    return tables


def joined(
    lines: Mapping[str, list[pd.DataFrame]], figures: Mapping[str, object]
) -> dict[str, pd.DataFrame]:
    """One frame for each row, empty if nothing of it is finished."""
    empty = pd.DataFrame(columns=["seed", *figures])
    return {
        row: pd.concat(parts, ignore_index=True) if parts else empty for row, parts in lines.items()
    }


def why_missing(test: Test, cfg: DictConfig) -> str:
    """What stands in the place of figures that are not there."""
    why = failure_file(Path(cfg.runs), test)
    return f"failed: {shorten(why.read_text(), 100)}" if why.exists() else "not run"


def table_lines(title: str, table: Mapping[str, Mapping[str, Cell]]) -> pd.DataFrame:
    """The numbers of one table, with the test's title if it has one."""
    frame = as_frame(table)
    if title:
        frame.insert(0, "test", title)
    return frame


def write_curves(runs: list[Run], cfg: DictConfig) -> None:
    """The learning curves with bands over seeds, of the rows of which there are any."""
    results, name = Path(cfg.results), cfg.study.name
    curves: dict[str, list[pd.DataFrame]] = {}
    for run in runs:
        path = result_file(results, run.tests[0])
        if path.exists():
            curve = pd.read_csv(path.with_name(f"{path.stem}_curve.csv"))
            curves.setdefault(run.row, []).append(curve)
    for ending in ("png", "pdf") if curves else ():
        learning_bands(curves, results / f"{name}.{ending}", title=name)


if __name__ == "__main__":
    start(main)
