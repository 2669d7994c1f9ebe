"""Runs a push battery: ``python -m recipes.evaluate run=DIR battery=planar``."""

import shlex
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from zfall.commands import remove_if_empty, shell_line
from zfall.errors import check_flags, check_keys, check_lists, check_whole
from zfall.evaluation.baselines import baseline_names
from zfall.evaluation.candidate import load_candidates
from zfall.evaluation.definitions import Battery, battery_of, table_of
from zfall.evaluation.kinds import kind_of
from zfall.evaluation.report import write_report
from zfall.evaluation.results import write_comparison
from zfall.evaluation.run import run_or_read, setting_name
from zfall.evaluation.single_trial import show_trial
from zfall.trust import trusting

from .shell import choice, one_line_errors, servo_change, start

OPTIONS = ["point", "duration", "directions", "impulses", "starts", "force_starts", "resolution"]
OPTIONS += ["end_time"]
KEYS = {"run", "runs", "battery", "checkpoint", "num_envs", "seed", "env", "keep", "trial", "video"}
KEYS |= {"joint", "change", "trust", *OPTIONS}


@hydra.main(version_base=None, config_path=".", config_name="evaluate")
def main(cfg: DictConfig) -> None:
    """Writes ``evaluation/SETTING/{trials.csv, summary.json, *.png}`` into the run folder."""
    console = Console()
    output = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors(), trusting(cfg.trust):
        check_values(cfg)
        options = {key: cfg[key] for key in OPTIONS if cfg[key] is not None}
        battery = battery_of(cfg.battery, **options)
        names = names_of(cfg, battery)
        candidates = load_candidates(
            names,
            task=cfg.env if choice("env") else None,
            default_task=kind_of(battery).baseline_task,
            checkpoint=cfg.checkpoint,
            change=[*servo_change(), *cfg.change],
            keep=cfg.keep,
        )
        setting = setting_of(cfg, options)
        places = {name: output / name if cfg.runs is not None else output for name in names}
        folders = {each.name: each.results(places[each.name]) / setting for each in candidates}
        if cfg.trial is not None:
            folder = folders[names[0]] if len(names) == 1 else output
            given = {"seed": cfg.seed, "joint": cfg.joint, "video": cfg.video}
            show_trial(battery, cfg.trial, candidates, folders, folder, console, **given)
            remove_if_empty(output)
            return
        results = {}
        try:
            for each in candidates:
                folders[each.name].mkdir(parents=True, exist_ok=True)
            for each in candidates:
                given = {"seed": cfg.seed, "num_envs": cfg.num_envs, "read": cfg.runs is not None}
                results[each.name] = run_or_read(
                    battery, each, folders[each.name], console=console, **given
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


def check_values(cfg: DictConfig) -> None:
    """Refuses values of the recipe itself that make no sense."""
    check_keys(cfg, KEYS)
    check_lists(cfg, ("runs", "keep", "change"))
    check_whole(cfg, ["num_envs"], 1)
    check_whole(cfg, ["seed"])
    check_flags(cfg, ["video"])
    if (cfg.run is None) == (cfg.runs is None):
        raise ValueError(
            f"run must be a run folder, or {' or '.join(baseline_names())}, or runs a list of "
            f"them; got {'none' if cfg.run is None else 'both'}."
        )
    if cfg.video and cfg.trial is None:
        raise ValueError("video needs a trial, by its number in trials.csv: trial=1000.")


def names_of(cfg: DictConfig, battery: Battery) -> list[str]:
    """The policies to test, each once."""
    independent = kind_of(battery).independent
    if cfg.runs is not None and not independent:
        raise ValueError(
            f"runs needs a battery whose trials are the same for all; {battery.name} is not."
        )
    if cfg.trial is not None and (cfg.keep or not independent):
        raise ValueError(
            f"trial needs a battery whose trials are independent, and no keep; got {battery.name}."
        )
    return [cfg.run] if cfg.runs is None else list(dict.fromkeys(cfg.runs))


def setting_of(cfg: DictConfig, options: dict[str, Any]) -> str:
    """Name of the folder of results, from all that was given and changes them."""
    name = HydraConfig.get().runtime.choices["battery"]
    stored = table_of(name)
    differs = {str(key): v for key, v in cfg.battery.items() if v != stored[key]}
    given = options | {key: v for key, v in differs.items() if key not in options}
    given |= {"servo": choice("servo")} if choice("servo") else {}
    given |= {"change": cfg.change} if cfg.change else {}
    given |= {"keep": sorted(cfg.keep)} if cfg.keep else {}
    given |= {"seed": cfg.seed} if cfg.seed != 0 else {}
    given |= {"checkpoint": cfg.checkpoint} if cfg.checkpoint != "last" else {}
    return setting_name(name, given)


if __name__ == "__main__":
    start(main)
