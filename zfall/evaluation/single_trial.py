"""One trial of a battery alone: its row, its traces, its film."""

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from omegaconf import DictConfig
from rich.console import Console
from tensordict import TensorDictBase

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.battery import battery_env, run_battery
from zfall.evaluation.candidate import Tested
from zfall.evaluation.definitions import Battery
from zfall.evaluation.plots import trace_plot
from zfall.evaluation.results import labels
from zfall.evaluation.video import film


def show_trial(
    battery: Battery, tested: list[Tested], cfg: DictConfig, console: Console, folder: Path
) -> None:
    """Runs a trial again with each policy, prints its rows, draws traces of ``cfg.joint``.

    Writes ``trial_N.csv`` (targets, positions and torques of all joints, with ``video`` also
    ``trial_N.mp4``) into the folder of each policy, ``trial_N_JOINT.{png,pdf}`` of all into
    ``folder``.
    """
    traces: dict[str, pd.DataFrame] = {}
    pushes: list[tuple[float, float]] = []
    for each in tested:
        row, rows, pushed = run_trial(battery, each, cfg, console)
        joint = str(cfg.joint)
        renamed = {f"{key}/{joint}": key for key in ("target", "position", "torque")}
        traces[each.name] = rows.rename(columns=renamed)
        if battery.interval is not None:  # a row of them, at the resolution of control steps
            pushes += pushed
        elif row["impulse"] > 0:
            pushes = [(battery.push_time, battery.push_time + row["duration_s"])]
    traces = dict(zip(labels(list(traces)), traces.values(), strict=True))
    for ending in ("png", "pdf"):
        path = folder / f"trial_{cfg.trial}_{joint}.{ending}"
        trace_plot(traces, path, joint=joint, pushes=pushes)
        console.print(f"wrote {path}", soft_wrap=True)


def run_trial(
    battery: Battery, tested: Tested, cfg: DictConfig, console: Console
) -> tuple[dict[Hashable, Any], pd.DataFrame, list[tuple[float, float]]]:
    """A trial's row, what its joints did in each control step, and when it was pushed [s]."""
    states: list[NDArray[np.float64]] = []
    forces: list[NDArray[np.float32]] = []
    signals: list[NDArray[np.float32]] = []
    env, _, _ = battery_env(battery, tested.env_cfg, 1)
    joints = env.base_env.robot.joints
    if cfg.joint not in joints:
        raise ValueError(f"joint must be one of {', '.join(joints)}, got {cfg.joint}.")

    def watch(base: HumanoidEnv, td: TensorDictBase) -> None:
        states.append(base.simulation.qpos[:1].numpy().copy())
        forces.append(td["push", "force"][:1].numpy().copy())
        keys = ("target", "joint_position", "joint_torque")
        signals.append(np.concatenate([td[key][0].numpy() for key in keys]))

    (row,) = run_battery(
        battery,
        tested.env_cfg,
        tested.actor,
        seed=cfg.seed,
        servos=tested.servos,
        only=[cfg.trial],
        watch=watch,
    ).to_dict("records")
    tested.folder.mkdir(parents=True, exist_ok=True)
    console.print(
        f"trial {cfg.trial} of {battery.name}, {tested.name}: {told(row)}", soft_wrap=True
    )
    for key, value in row.items():
        console.print(f"  {key}: {value:.4g}" if isinstance(value, float) else f"  {key}: {value}")
    names = [f"{key}/{joint}" for key in ("target", "position", "torque") for joint in joints]
    rows = pd.DataFrame(np.stack(signals), columns=names)
    rows.insert(0, "time_s", env.base_env.control_dt * (1 + np.arange(len(rows))))
    rows.to_csv(tested.folder / f"trial_{cfg.trial}.csv", index=False)
    if cfg.video:
        path = tested.folder / f"trial_{cfg.trial}.mp4"
        label = f"I = {row['impulse']:.2g}"
        if np.isfinite(row["direction_rad"]):
            label += f", {np.degrees(row['direction_rad']):.0f} degrees"
        shown = {Path(tested.name).name: np.stack(states)}
        dt = env.base_env.control_dt
        try:
            film(env.base_env.simulation.model, shown, [label], np.stack(forces), path, dt=dt)
            console.print(f"wrote {path}", soft_wrap=True)
        except RuntimeError as error:
            console.print(f"no video: {error}")
    acting = np.concatenate(forces).reshape(len(forces), -1).any(1).astype(int)
    edges = np.flatnonzero(np.diff(acting, prepend=0, append=0)) * env.base_env.control_dt
    return row, rows, list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def told(row: dict[Hashable, Any]) -> str:
    """A trial in one line: how it was pushed, and what came of it."""
    outcome = next(
        (name for name in ("recovered", "kneeled", "fell") if row.get(name)), "stands bent"
    )
    if row["impulse"] == 0:
        return f"not pushed, {outcome}"
    push = f"I = {row['impulse']:.2f}, {row['force_n']:.1f} N for {row['duration_s']:g} s"
    if np.isfinite(row["direction_rad"]):
        push += f" toward {np.degrees(row['direction_rad']):.0f} degrees (0 forward, 90 left)"
    return f"{push} at {row['body']}, {outcome}"
