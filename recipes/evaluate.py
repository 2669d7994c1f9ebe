"""Runs a push battery: ``python -m recipes.evaluate run=DIR battery=planar``."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import remove_if_empty, shell_line
from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Count, FractionAboveZero, Name, Positive, Rule, Seed, Times, Whole

from .shell import (
    Changes,
    Checkpoint,
    Run,
    check_recipe,
    choice,
    given_but,
    loading,
    one_line_errors,
    start,
)


class Keys(TypedDict):
    """The keys of ``evaluate.yaml``."""

    run: Run | None
    runs: Annotated[Sequence[Run], Rule("name at least one", lambda x: len(x) > 0)] | None
    battery: Mapping[str, Any]
    checkpoint: Checkpoint
    num_envs: Count
    seed: Seed
    env: NotRequired[Mapping[str, Any] | None]  # servo=NAME alone gives a part of one
    keep: Changes
    memory: bool
    trial: Whole | None
    video: bool
    slow: FractionAboveZero
    slow_for: Positive | None
    shown: Times | None
    references: bool
    joint: Name
    servo: NotRequired[Any]
    trust: Changes
    change: Changes
    point: Name | Sequence[Name] | None
    duration: Positive | Sequence[Positive] | None
    directions: Count | None
    impulses: Sequence[Positive] | None
    starts: Count | None
    force_starts: Whole | None
    resolution: Positive | None
    end_time: Positive | None


OPTIONS = ["point", "duration", "directions", "impulses", "starts", "force_starts", "resolution"]
OPTIONS += ["end_time"]


@hydra.main(version_base=None, config_path=".", config_name="evaluate")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``evaluation/SETTING/{trials.csv, summary.json, *.png}`` into the run folder."""
    output = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, Keys)
    with one_line_errors(), trusting(cfg.trust):
        from rich.console import Console

        from zfall.evaluation.candidate import load_candidates
        from zfall.evaluation.definitions import battery_of
        from zfall.evaluation.kinds import kind_of
        from zfall.evaluation.report import write_report
        from zfall.evaluation.results import write_comparison
        from zfall.evaluation.run import run_or_read
        from zfall.evaluation.settings import check_values, names_of, setting_of
        from zfall.evaluation.single_trial import show_trial
        from zfall.evaluation.video import Cut

        console = Console()
        check_values(cfg, choice("servo"))
        options = {key: cfg[key] for key in OPTIONS if cfg[key] is not None}
        battery = battery_of(cfg.battery, **options)
        names = names_of(cfg, battery)
        candidates = load_candidates(
            names,
            default_task=kind_of(battery).baseline_task,
            **loading(cfg),
            keep=cfg.keep,
            memory=cfg.memory,
            world=battery.world,
        )
        setting = setting_of(cfg, options, str(choice("battery")), choice("servo"), choice("robot"))
        places = {name: output / name if cfg.runs is not None else output for name in names}
        folders = {each.name: each.results(places[each.name]) / setting for each in candidates}
        if cfg.trial is not None:
            folder = folders[names[0]] if len(names) == 1 else output
            given = {key: cfg[key] for key in ("seed", "joint", "video")}
            given["cut"] = cut = Cut(cfg.slow, cfg.slow_for, cfg.shown)
            cut.check(battery.end_time)
            show_trial(battery, cfg.trial, candidates, folders, folder, console, **given)
            remove_if_empty(output)
            return
        results = {}
        try:
            for each in candidates:
                folders[each.name].mkdir(parents=True, exist_ok=True)
            for each in candidates:
                results[each.name] = run_or_read(
                    battery,
                    each,
                    folders[each.name],
                    seed=cfg.seed,
                    num_envs=cfg.num_envs,
                    console=console,
                    read=cfg.runs is not None,
                    referenced=cfg.references,
                    shell=given_but("run", "runs", "num_envs", "references"),
                )
        finally:  # of what was refused nothing stays
            for folder in folders.values():
                remove_if_empty(folder)
                remove_if_empty(folder.parent)
    if len(results) > 1:
        folder = output / "comparison" / setting
        folder.mkdir(parents=True, exist_ok=True)
        write_comparison(results, folder, console)
        command = shell_line("evaluate", *map(shlex.quote, HydraConfig.get().overrides.task))
        console.print(f"wrote {write_report(folder, command)}", soft_wrap=True)
    for each in candidates:
        run = Path(each.name)
        if each.actor is not None and folders[each.name].parents[1] == run:
            console.print(f"wrote {write_report(run)}", soft_wrap=True)
    remove_if_empty(output)  # the results lie in the run folder


if __name__ == "__main__":
    start(main)
