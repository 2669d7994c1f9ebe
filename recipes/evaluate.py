"""Runs a push battery: ``python -m recipes.evaluate run=DIR battery=planar``."""

import hashlib
import itertools
import shlex
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import hydra
import pandas as pd
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf, open_dict
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from recipes.shell import one_line_errors, start
from zfall.commands import remove_if_empty, shell_line
from zfall.envs.make import left_out
from zfall.errors import check_flags, check_keys, check_lists, check_whole
from zfall.evaluation.battery import run_battery, starts_and_pushes
from zfall.evaluation.candidate import (
    BASELINES,
    SCRIPTED,
    Tested,
    held,
    load_run,
    read_trials,
    write_trials,
)
from zfall.evaluation.definitions import Battery, load_battery
from zfall.evaluation.envelope import run_envelope
from zfall.evaluation.report import write_report
from zfall.evaluation.results import write_comparison, write_envelope, write_results
from zfall.evaluation.single_trial import show_trial

OPTIONS = (
    *("point", "duration", "directions", "impulses", "starts", "force_starts", "resolution"),
    "end_time",
)
KEYS = {
    "run",
    "runs",
    "battery",
    "checkpoint",
    "num_envs",
    "seed",
    "env",
    "keep",
    "trial",
    "video",
    "joint",
    "change",
}


@hydra.main(version_base=None, config_path=".", config_name="evaluate")
def main(cfg: DictConfig) -> None:
    """Writes ``evaluation/SETTING/{trials.csv, summary.json, *.png}`` into the run folder."""
    console = Console()
    output = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_keys(cfg, KEYS | set(OPTIONS))
        check_lists(cfg, ("runs", "keep", "change"))
        check_whole(cfg, ["num_envs"], 1)
        check_whole(cfg, ["seed"])
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
        check_flags(cfg, ["video"])
        if cfg.video and cfg.trial is None:
            raise ValueError("video needs a trial, by its number in trials.csv: trial=1000.")
        names = [cfg.run] if cfg.runs is None else list(dict.fromkeys(cfg.runs))
        own = [name for name in names if name not in BASELINES]
        if own and cfg.get("env") is not None:
            raise ValueError(
                f"env must be given for baselines alone, {own[0]} is tested in its own world "
                "(change=[...] replaces values of it)."
            )
        tested = [
            Tested.load(in_world_of_policies(cfg, name, names), name, output, setting_of(cfg))
            for name in names
        ]
        if cfg.trial is not None:
            folder = tested[0].folder if len(tested) == 1 else output
            show_trial(battery, tested, cfg, console, folder)
            remove_if_empty(output)
            return
        for each in tested:
            each.folder.mkdir(parents=True, exist_ok=True)
        try:
            results = {each.name: run_or_read(battery, each, cfg, console) for each in tested}
        finally:  # of what was refused nothing stays
            for each in tested:
                remove_if_empty(each.folder)
                remove_if_empty(each.folder.parent)
    if len(tested) > 1:
        folder = output / "comparison" / setting_of(cfg)
        folder.mkdir(parents=True, exist_ok=True)
        write_comparison(battery, results, folder, console, robot=tested[0].robot)
        command = shell_line("evaluate", *map(shlex.quote, HydraConfig.get().overrides.task))
        console.print(f"wrote {write_report(folder, command)}", soft_wrap=True)
    for each in tested:
        if each.actor is not None and each.folder.parents[1] == Path(each.name):
            console.print(f"wrote {write_report(Path(each.name))}", soft_wrap=True)
    remove_if_empty(output)  # the results lie in the run folder


def in_world_of_policies(cfg: DictConfig, name: str, names: Sequence[str]) -> DictConfig:
    """The config for a baseline, which meets the world of the first policy beside it.

    One that kneels that of the first that has modes.
    """
    if name not in BASELINES or cfg.get("env") is not None:
        return cfg
    for policy in (other for other in names if other not in BASELINES):
        world = load_run(cfg, policy)[0]
        if name not in SCRIPTED or world.transforms.get("kneel_reference") is not None:
            given = cfg.copy()
            with open_dict(given):
                given.env = world
            return given
    return cfg


def setting_of(cfg: DictConfig) -> str:
    """Name of the folder of results: the battery and what differs from it, ``planar_starts-5``.

    Results of one setting do not overwrite those of another.
    """
    given = {key: cfg[key] for key in (*OPTIONS, "change") if cfg[key] not in (None, [])}
    if cfg.keep:
        given["keep"] = sorted(cfg.keep)
    given |= {"seed": cfg.seed} if cfg.seed != 0 else {}
    given |= {"checkpoint": cfg.checkpoint} if cfg.checkpoint != "last" else {}
    texts = {
        k: ",".join(map(str, [v] if isinstance(v, (str, float, int)) else v))
        for k, v in given.items()
    }
    name = "_".join([cfg.battery, *(f"{key}-{text}" for key, text in texts.items())])
    if len(name) > 100 or "/" in name:
        digest = hashlib.sha256(name.encode()).hexdigest()[:8]
        name = f"{cfg.battery}_{digest}"
    return name


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
    only = left_out(OmegaConf.select(tested.env_cfg, "training_only", default={}))
    gone = ", ".join(dict.fromkeys([*only, *starts_and_pushes(tested.env_cfg)]))
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
    planar = battery.interval is None and not battery.forces
    if planar and tested.name not in BASELINES:
        short = replace(battery, starts=min(battery.starts, 5))
        still = Tested("pose_hold", held(tested.env_cfg), None, folder, "")
        baseline = evaluate(short, still, cfg, console, name="pose_hold, 5 starts")
    write_trials(folder / "trials.csv", trials, asked)
    partial.unlink(missing_ok=True)
    partial.with_suffix(".json").unlink(missing_ok=True)
    write_results(
        battery,
        trials,
        baseline,
        folder,
        console,
        name=Path(tested.name).name,
        robot=tested.robot,
    )
    return trials


def bisect(battery: Battery, tested: Tested, cfg: DictConfig, console: Console) -> pd.DataFrame:
    """The largest pushes recovered from, beside those of ``pose_hold``, and their files.

    Rounds that an interrupted call finished are not run again.
    """
    folder, asked = tested.folder, tested.asked(battery, cfg)
    rounds = folder / "rounds"
    rounds.mkdir(exist_ok=True)
    pairs = {Path(tested.name).name: tested}
    if tested.name not in BASELINES:
        pairs["pose_hold"] = Tested("pose_hold", held(tested.env_cfg), None, folder, "")
    tables: dict[str, pd.DataFrame] = {}
    trials = pd.DataFrame()
    for name, each in reversed(pairs.items()):  # the run's own trials come last, and are kept
        numbers = itertools.count()

        def run(plan: pd.DataFrame, name: str = name, each: Tested = each) -> pd.DataFrame:
            number = next(numbers)  # noqa: B023
            path, wanted = rounds / f"{name}_{number}.csv", asked | {"of": name, "round": number}
            done = read_trials(path, wanted)
            if done is None:
                label = f"{name}, round {number}"
                done = evaluate(battery, each, cfg, console, plan=plan, name=label)
                write_trials(path, done, wanted)
            return done

        tables[name], trials = run_envelope(battery, cfg.seed, run, unit=tested.robot.impulse_unit)
    write_trials(folder / "trials.csv", trials, asked)
    shutil.rmtree(rounds)
    write_envelope(
        battery, dict(reversed(tables.items())), trials, folder, console, robot=tested.robot
    )
    return trials


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
