"""Runs a push battery: ``python -m recipes.evaluate run=DIR battery=planar``."""

import itertools
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import hydra
import numpy as np
import pandas as pd
from hydra.core.hydra_config import HydraConfig
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from tensordict import TensorDictBase

from recipes.one_line import check_keys, one_line_errors, start
from recipes.showcase import table
from recipes.tested import BASELINES, Tested, read_trials, write_trials
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import left_out
from zfall.evaluation.battery import Battery, battery_env, load_battery, run_battery
from zfall.evaluation.comparison import compare
from zfall.evaluation.envelope import run_envelope
from zfall.evaluation.plots import envelope_plot, overlay, success_map
from zfall.evaluation.statistics import summarize
from zfall.evaluation.video import film

OPTIONS = ("point", "duration", "directions", "impulses", "starts", "resolution")
KEYS = {"run", "runs", "battery", "checkpoint", "num_envs", "seed", "env", "keep", "trial", "video"}


@hydra.main(version_base=None, config_path=".", config_name="evaluate")
def main(cfg: DictConfig) -> None:
    """Writes ``evaluation/BATTERY/{trials.csv, summary.json, *.png}`` into the run folder."""
    console = Console()
    output = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_keys(cfg, KEYS | set(OPTIONS))
        options = {key: cfg[key] for key in OPTIONS if cfg[key] is not None}
        battery = load_battery(cfg.battery, **options)
        if (cfg.run is None) == (cfg.runs is None):
            raise ValueError(
                f"run must be a run folder, or {' or '.join(BASELINES)}, or runs a list of them; "
                f"got {'none' if cfg.run is None else 'both'}."
            )
        if cfg.runs is not None and battery.resolution is not None:
            raise ValueError(
                f"runs needs a battery whose trials are the same for all; {battery.name} is not."
            )
        if cfg.trial is not None and (cfg.keep or battery.resolution is not None):
            raise ValueError(
                "trial needs a battery whose trials are independent: not envelope, and no keep."
            )
        names = [cfg.run] if cfg.runs is None else list(dict.fromkeys(cfg.runs))
        tested = [Tested.load(cfg, name, output) for name in names]
        if cfg.trial is not None:
            for each in tested:
                show_trial(battery, each, cfg, console)
            return
    results = {each.name: run_or_read(battery, each, cfg, console) for each in tested}
    if len(tested) > 1:
        folder = output / "comparison" / cfg.battery
        folder.mkdir(parents=True, exist_ok=True)
        write_comparison(battery, results, folder, console)
    if not any(output.iterdir()):  # hydra makes it; the results lie in the run folder
        output.rmdir()


def run_or_read(
    battery: Battery, tested: Tested, cfg: DictConfig, console: Console
) -> pd.DataFrame:
    """All trials of a battery, and its files; goes on where an interrupted one stopped.

    A comparison reads what is there already from the same checkpoint and definition.
    """
    if battery.resolution is not None:
        return bisect(battery, tested, cfg, console)
    folder, asked = tested.folder, tested.asked(battery, cfg)
    if cfg.runs is not None and (done := read_trials(folder / "trials.csv", asked)) is not None:
        console.print(f"{battery.name} of {tested.name}: read from {folder}/trials.csv")
        return done
    gone = ", ".join(left_out(OmegaConf.select(tested.env_cfg, "training_only", default={})))
    console.print(
        f"{battery.name} of {tested.name}; of the env's transforms left out: {gone or 'nothing'}"
    )
    partial = folder / "trials.partial.csv"
    finished = read_trials(partial, asked)
    if finished is not None:
        console.print(f"goes on after {len(finished)} trials of {partial}")
    trials = evaluate(
        battery,
        tested,
        cfg,
        console,
        finished=finished,
        keep=lambda so_far: write_trials(partial, so_far, asked),
    )
    baseline = None
    if tested.name not in BASELINES:
        short = replace(battery, starts=min(battery.starts, 5))
        held = Tested("pose_hold", tested.env_cfg, None, folder, "")
        baseline = evaluate(short, held, cfg, console, name="pose_hold, 5 starts")
    summary = summarize(battery, trials)
    write_trials(folder / "trials.csv", trials, asked)
    partial.unlink(missing_ok=True)
    (folder / "summary.json").write_text(json.dumps(summary, indent=2))
    title = f"{Path(tested.name).name}: share recovered, {battery.name}"
    success_map(trials, folder / "success_map.png", title=title, baseline=baseline)
    console.print(table({tested.name: summary}))
    console.print(
        f"I50 mean {summary['i50_mean']:.3f}, least {summary['i50_min']:.2f}; "
        f"I90 mean {summary['i90_mean']:.3f}; "
        f"falls without a push {summary['control_falls']} of {summary['control_n']}"
    )
    console.print(f"wrote {folder}/trials.csv, summary.json, success_map.png")
    return trials


def bisect(battery: Battery, tested: Tested, cfg: DictConfig, console: Console) -> pd.DataFrame:
    """The largest pushes recovered from, beside those of ``pose_hold``, and their files."""
    pairs = {Path(tested.name).name: tested}
    if tested.name not in BASELINES:
        pairs["pose_hold"] = Tested("pose_hold", tested.env_cfg, None, tested.folder, "")
    tables: dict[str, pd.DataFrame] = {}
    trials = pd.DataFrame()
    for name, each in reversed(pairs.items()):  # the run's own trials come last, and are kept
        rounds = itertools.count()

        def run(plan: pd.DataFrame, name: str = name, each: Tested = each) -> pd.DataFrame:
            label = f"{name}, round {next(rounds)}"  # noqa: B023
            return evaluate(battery, each, cfg, console, plan=plan, name=label)

        tables[name], trials = run_envelope(battery, cfg.seed, run)
    folder = tested.folder
    write_trials(folder / "trials.csv", trials, tested.asked(battery, cfg))
    tables = dict(reversed(tables.items()))
    table = tables[next(iter(pairs))]
    table.to_csv(folder / "envelope.csv", index=False)
    means = table.groupby("body", sort=False)["largest"].agg(["mean", "min"])
    control = trials[trials["impulse"] == 0]
    summary = {
        "battery": battery.name,
        "battery_version": battery.version,
        "definition": asdict(battery),
        "seed": cfg.seed,
        "n": len(trials),
        "largest_mean": means["mean"].to_dict(),
        "largest_min": means["min"].to_dict(),
        "control_falls": int(control["fell"].sum()),
        "control_n": len(control),
    }
    (folder / "summary.json").write_text(json.dumps(summary, indent=2))
    for ending in ("png", "pdf"):
        title = "largest impulse recovered from"
        envelope_plot(tables, folder / f"envelope.{ending}", title=title)
    console.print(markdown(means.reset_index()), markup=False)
    console.print(
        f"wrote {folder}/trials.csv, envelope.csv, summary.json, envelope.png, envelope.pdf"
    )
    return trials


def write_comparison(
    battery: Battery, results: dict[str, pd.DataFrame], folder: Path, console: Console
) -> None:
    """One table and one overlay plot of several runs on the same trials."""
    summaries = {name: summarize(battery, trials) for name, trials in results.items()}
    short = dict(zip(results, labels(list(results)), strict=True))
    figures = ("i50_mean", "i50_min", "i90_mean", "target_smoothness", "control_falls")
    paired = compare(results)
    for figure in figures:
        paired[figure] = [summaries[name][figure] for name in paired["run"]]
    paired.to_csv(folder / "comparison.csv", index=False)
    (folder / "comparison.md").write_text(markdown(paired))
    for ending in ("png", "pdf"):
        overlay(
            {short[k]: v for k, v in results.items()},
            folder / f"overlay.{ending}",
            title=f"I50, {battery.name}",
        )
    console.print(table({short[name]: summary for name, summary in summaries.items()}))
    console.print((folder / "comparison.md").read_text(), markup=False, soft_wrap=True)
    console.print(f"wrote {folder}/comparison.csv, comparison.md, overlay.png, overlay.pdf")


def labels(names: list[str]) -> list[str]:
    """The last folder of each name, or the whole of it if two have the same."""
    last = [Path(name).name for name in names]
    return [
        short if last.count(short) == 1 else name for short, name in zip(last, names, strict=True)
    ]


def markdown(rows: pd.DataFrame) -> str:
    """A table in Markdown, numbers with three digits."""
    cells = rows.map(lambda value: f"{value:.3g}" if isinstance(value, float) else str(value))
    lines = [list(rows.columns), ["---"] * rows.shape[1], *cells.to_numpy().tolist()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def show_trial(battery: Battery, tested: Tested, cfg: DictConfig, console: Console) -> None:
    """Runs one trial again, prints its row, and films it if asked."""
    states: list[NDArray[np.float64]] = []
    forces: list[NDArray[np.float32]] = []

    def watch(env: HumanoidEnv, td: TensorDictBase) -> None:
        states.append(env.simulation.qpos[:1].numpy().copy())
        forces.append(td["push", "force"][:1].numpy().copy())

    (row,) = run_battery(
        battery,
        tested.env_cfg,
        tested.actor,
        seed=cfg.seed,
        servos=tested.servos,
        only=[cfg.trial],
        watch=watch,
    ).to_dict("records")
    console.print(f"trial {cfg.trial} of {battery.name}, {tested.name}")
    for key, value in row.items():
        console.print(f"  {key}: {value:.4g}" if isinstance(value, float) else f"  {key}: {value}")
    if cfg.video:
        path = tested.folder / f"trial_{cfg.trial}.mp4"
        env, _, _ = battery_env(battery, tested.env_cfg, 1)
        label = f"I = {row['impulse']:.2g}, {np.degrees(row['direction_rad']):.0f} degrees"
        shown = {Path(tested.name).name: np.stack(states)}
        dt = env.base_env.control_dt
        try:
            film(env.base_env.simulation.model, shown, [label], np.stack(forces), path, dt=dt)
            console.print(f"wrote {path}")
        except RuntimeError as error:
            console.print(f"no video: {error}")


def evaluate(
    battery: Battery,
    tested: Tested,
    cfg: DictConfig,
    console: Console,
    *,
    name: str | None = None,
    plan: pd.DataFrame | None = None,
    finished: pd.DataFrame | None = None,
    keep: Callable[[pd.DataFrame], None] = lambda trials: None,
) -> pd.DataFrame:
    """Runs the battery with a progress bar."""
    columns = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    label = name or f"{battery.name} of {tested.name}"
    with Progress(TextColumn(label), BarColumn(), *columns, console=console) as bar:
        task = bar.add_task(label)
        return run_battery(
            battery,
            tested.env_cfg,
            tested.actor,
            seed=cfg.seed,
            num_envs=cfg.num_envs,
            servos=tested.servos,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
            plan=plan,
            finished=finished,
            keep=keep,
        )


if __name__ == "__main__":
    start(main)
