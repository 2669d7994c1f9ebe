"""What a training run shows at its end: a short battery, plots and a film."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from omegaconf import DictConfig
from rich.console import Console
from torch import Tensor

from zfall.commands import shell_line, shown_path
from zfall.envs.tables import robot_of
from zfall.evaluation.baselines import passive
from zfall.evaluation.battery import battery_env, play, run_battery
from zfall.evaluation.captions import Pushed, PushLog
from zfall.evaluation.definitions import Battery, load_battery
from zfall.evaluation.endings import Endings
from zfall.evaluation.followers import followers_of
from zfall.evaluation.headings import heading, surroundings
from zfall.evaluation.kinds import kind_of
from zfall.evaluation.kinds.planar import success_by_size
from zfall.evaluation.plots import learning_curves, success_map
from zfall.evaluation.report import write_report
from zfall.evaluation.run_files import read_table
from zfall.evaluation.statistics import summarize
from zfall.evaluation.video import Outcomes, film, frame
from zfall.evaluation.writers import write_summary
from zfall.terminal import print_sheet

SIDES = {
    "from behind": 0.0,
    "from the right": 90.0,
    "from the front": 180.0,
    "from the left": 270.0,
}
FILMED = ("from behind", "from the left")
LENGTH = 3.6  # of the film [s]


def battery_of(cfg: DictConfig) -> Battery | None:
    """The short battery that ``showcase`` of a training asks for, if it asks for one.

    Raises:
        ValueError: on one that does not push once in level directions.
    """
    showcase = cfg.showcase
    if not showcase:
        return None
    name = showcase.get("battery", "planar")
    battery = load_battery(name, impulses=list(showcase.sizes), starts=showcase.starts)
    if not kind_of(battery).needs_training_size:  # which alone has a success by size
        raise ValueError(
            f"showcase.battery must be planar, twin or another of their kind, got {name}."
        )
    return battery


def show(
    cfg: DictConfig,
    actor: torch.nn.Module,
    untrained: dict[str, Tensor],
    folder: Path,
    console: Console,
) -> None:
    """Runs a short battery before and after training and of ``pose_hold``.

    Writes plots, ``video.mp4`` and ``summary.json`` into the run folder and prints a table.
    """
    battery = battery_of(cfg)
    assert battery is not None
    battery = battery.of_size(robot_of(cfg.env))
    trained = {key: value.clone() for key, value in actor.state_dict().items()}
    with console.status(f"short {battery.name} battery"):
        actor.load_state_dict(untrained)
        before = run_battery(battery, cfg.env, actor)
        actor.load_state_dict(trained)
        after = run_battery(battery, cfg.env, actor)
        baseline = run_battery(battery, passive(cfg.env), None)
    plots = folder / "plots"
    plots.mkdir(exist_ok=True)
    summaries = {
        "before": summarize(battery, before),
        "after": summarize(battery, after),
        "pose_hold": summarize(battery, baseline),
    }
    write_summary(folder, summaries)
    learning_curves(read_table(folder / "metrics.csv"), plots / "learning_curves.png")
    where, counted = surroundings(cfg.env, battery), f"{battery.starts} per direction and size"
    title = heading("trained", battery, robot_of(cfg.env), where, counted)
    success_map(after, plots / f"{battery.name}.png", title=title, baseline=baseline)
    print_sheet(success_by_size(summaries), console)
    if cfg.showcase.video:
        with console.status("video"):
            video(battery, cfg.env, actor, folder / "video.mp4", console)
    console.print(f"run folder: {shown_path(folder)}")
    board = "tensorboard/, " if (folder / "tensorboard").is_dir() else ""
    console.print(f"  metrics.csv, timing.csv, {board}checkpoints/{{last,best}}.pt", soft_wrap=True)
    film_name = "video.mp4, " if (folder / "video.mp4").exists() else ""
    console.print(f"  plots/learning_curves.png, plots/{battery.name}.png, {film_name}summary.json")
    console.print(f"  {write_report(folder).name}")
    line = shell_line("evaluate", f"run={shown_path(folder)}", f"battery={battery.name}")
    console.print(f"next: {line}", soft_wrap=True)


def video(
    battery: Battery, env_cfg: DictConfig, actor: torch.nn.Module, path: Path, console: Console
) -> None:
    """Films a push of I = 0.4 from two sides, the policy above ``pose_hold``."""
    recorded = {
        "trained": record(battery, env_cfg, actor),
        "pose_hold": record(battery, passive(env_cfg), None),
    }
    shown = [list(SIDES).index(side) for side in FILMED]
    base = battery_env(battery, env_cfg, 64)[0].base_env
    try:
        film(
            base.camera.model,
            {name: each.states[:, shown] for name, each in recorded.items()},
            [f"pushed {side}; {surroundings(env_cfg, battery)}" for side in FILMED],
            recorded["trained"].pushed.of(shown),
            path,
            dt=frame(base),
            start=base.control_dt,
            outcomes={name: [each.outcomes[i] for i in shown] for name, each in recorded.items()},
            shadows=False,  # which take most of the time where no graphics card draws
        )
    except RuntimeError as error:
        console.print(f"no video: {error}")


@dataclass(frozen=True)
class Recorded:
    """A push from each side.

    Attributes:
        states: positions ``(T, 4, nq)`` in MuJoCo's order.
        pushed: what pushes them, from state to state.
        outcomes: what came of each.
    """

    states: NDArray[np.float64]
    pushed: Pushed
    outcomes: list[Outcomes]


def record(
    battery: Battery, env_cfg: DictConfig, actor: torch.nn.Module | None, size: float = 0.4
) -> Recorded:
    """A push from each side, recorded every ``frame`` seconds.

    Of 3.6 s, 0.6 lie before the push, which comes when that of the battery does.
    """
    env, _, push = battery_env(battery, env_cfg, 64)
    base = env.base_env
    force = size * base.robot.impulse_unit / battery.durations[0]
    for index, degrees in enumerate(SIDES.values()):
        heading = math.radians(degrees)
        push.plan[index] = force * torch.tensor([math.cos(heading), math.sin(heading), 0.0])
    push.time[:] = battery.push_time
    start = max(0, round((battery.push_time - 0.6) / base.control_dt))
    qpos, ends = [], []
    every = round(frame(base) / base.control_dt)
    endings, log = Endings(base, followers_of(battery)), PushLog(len(SIDES))
    steps = start + round(LENGTH / base.control_dt)
    for step, td in enumerate(play(env, actor, steps), start=-start):
        endings.update(td, (step + 1) * base.control_dt)
        if step < 0:
            continue
        log.add(td)
        if step % every == 0:
            qpos.append(base.simulation.qpos[: len(SIDES)].numpy().copy())
            ends.append(step + 1)
    outcomes = [endings.said(world, LENGTH, task=False) for world in range(len(SIDES))]
    return Recorded(np.stack(qpos), log.frames(ends), outcomes)
