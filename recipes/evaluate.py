"""Runs a push battery: ``python -m recipes.evaluate run=DIR battery=planar``."""

import json
from collections.abc import Sequence
from pathlib import Path

import hydra
import pandas as pd
import torch
from hydra import compose
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from recipes.one_line import check_keys, one_line_errors, start
from recipes.showcase import table
from zfall import checkpoint
from zfall.envs.make import left_out
from zfall.evaluation.battery import Battery, load_battery, run_battery
from zfall.evaluation.plots import success_map
from zfall.evaluation.statistics import summarize

BASELINES = ("pose_hold", "limp")
OPTIONS = ("point", "duration", "directions", "impulses", "starts")
KEYS = {"run", "battery", "checkpoint", "num_envs", "seed", "env", "keep", *OPTIONS}


@hydra.main(version_base=None, config_path=".", config_name="evaluate")
def main(cfg: DictConfig) -> None:
    """Writes ``evaluation/BATTERY/{trials.csv, summary.json, *.png}`` into the run folder."""
    with one_line_errors():
        check_keys(cfg, KEYS)
        options = {key: cfg[key] for key in OPTIONS if cfg[key] is not None}
        battery = load_battery(cfg.battery, **options)
        if cfg.run is None:
            raise ValueError(f"run must be a run folder, or {' or '.join(BASELINES)}; got none.")
        env_cfg, actor = load_run(cfg)
        env_cfg = keep(env_cfg, cfg.keep)
        output = Path(HydraConfig.get().runtime.output_dir)
        run = output if cfg.run in BASELINES else Path(cfg.run)
        folder = run / "evaluation" / cfg.battery
        folder.mkdir(parents=True, exist_ok=True)
    console = Console()
    gone = ", ".join(left_out(OmegaConf.select(env_cfg, "training_only", default={}))) or "nothing"
    console.print(f"{battery.name} of {cfg.run}; of the env's transforms left out: {gone}")
    trials = evaluate(battery, env_cfg, actor, cfg, console, servos=cfg.run != "limp")
    baseline = None
    if cfg.run not in BASELINES:
        short = load_battery(cfg.battery, **(options | {"starts": 5}))
        baseline = evaluate(short, env_cfg, None, cfg, console, name="pose_hold, 5 starts")
    summary = summarize(battery, trials)
    trials.to_csv(folder / "trials.csv.tmp", index=False)
    (folder / "trials.csv.tmp").replace(folder / "trials.csv")
    (folder / "summary.json").write_text(json.dumps(summary, indent=2))
    title = f"{Path(cfg.run).name}: share recovered, {battery.name}"
    success_map(trials, folder / "success_map.png", title=title, baseline=baseline)
    console.print(table({cfg.run: summary}))
    console.print(
        f"I50 mean {summary['i50_mean']:.3f}, least {summary['i50_min']:.2f}; "
        f"I90 mean {summary['i90_mean']:.3f}; "
        f"falls without a push {summary['control_falls']} of {summary['control_n']}"
    )
    console.print(f"wrote {folder}/trials.csv, summary.json, success_map.png")
    if not any(output.iterdir()):  # hydra makes it; the results lie in the run folder
        output.rmdir()


def load_run(cfg: DictConfig) -> tuple[DictConfig, torch.nn.Module | None]:
    """The env's config and the policy of a run, or of a baseline.

    Raises:
        ValueError: if the folder holds no checkpoint, or one that does not fit.
    """
    if cfg.run in BASELINES:
        return (cfg.env or compose("train", overrides=["num_envs=64"]).env), None
    path = Path(cfg.run) / "checkpoints" / f"{cfg.checkpoint}.pt"
    if not path.parent.parent.is_dir():
        raise ValueError(
            f"run must be a run folder, or {' or '.join(BASELINES)}; there is no folder {cfg.run}."
        )
    content = checkpoint.load(path)
    run_cfg = OmegaConf.create(content["config"])
    env_cfg = run_cfg.env
    env = instantiate(env_cfg, base_env={"num_envs": 1})
    actor = instantiate(run_cfg.actor, env.observation_spec, env.action_spec)
    checkpoint.check_fits(content, env.base_env.robot.name, actor, path)
    actor.load_state_dict(content["policy"])
    return env_cfg, actor


def keep(env_cfg: DictConfig, names: Sequence[str]) -> DictConfig:
    """The env's config with some of what evaluation leaves out kept on: noise, delays.

    Raises:
        ValueError: on a name that is not left out.
    """
    training_only = OmegaConf.select(env_cfg, "training_only", default={})
    unknown = [name for name in names if name not in training_only]
    if unknown:
        raise ValueError(
            f"keep must name what evaluation leaves out ({', '.join(training_only)}), "
            f"got {unknown[0]}."
        )
    kept = env_cfg.copy()
    for name in names:
        kept.training_only[name] = False
    return kept


def evaluate(
    battery: Battery,
    env_cfg: DictConfig,
    actor: torch.nn.Module | None,
    cfg: DictConfig,
    console: Console,
    *,
    servos: bool = True,
    name: str | None = None,
) -> pd.DataFrame:
    """Runs the battery with a progress bar."""
    columns = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    label = name or f"{battery.name} of {cfg.run}"
    with Progress(TextColumn(label), BarColumn(), *columns, console=console) as bar:
        task = bar.add_task(label)
        return run_battery(
            battery,
            env_cfg,
            actor,
            seed=cfg.seed,
            num_envs=cfg.num_envs,
            servos=servos,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )


if __name__ == "__main__":
    start(main)
