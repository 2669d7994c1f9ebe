"""One trial of a battery alone: its row, its traces, its film."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console
from tensordict import TensorDictBase

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.battery import battery_env, run_battery
from zfall.evaluation.candidate import Candidate
from zfall.evaluation.captions import PushLog
from zfall.evaluation.definitions import Battery
from zfall.evaluation.followers import followers_of, outcome_names
from zfall.evaluation.headings import surroundings
from zfall.evaluation.plans import Pushes, plan_pushes
from zfall.evaluation.plots import trace_plot
from zfall.evaluation.results import labels
from zfall.evaluation.video import Cut, film, frame


@dataclass(frozen=True)
class Replay:
    """A trial run again.

    Attributes:
        row: of ``trials.csv``.
        traces: ``time_s`` [s], and ``target``, ``position`` [rad] and ``torque`` [N m] of each
            joint, as ``target/JOINT``, after every control step.
        pushes: begin and end of each push [s].
        states: positions ``(T, 1, nq)`` in MuJoCo's order.
        log: what pushed it, step by step.
        env: its base env.
        limit: largest torque of the joint that is drawn [N m].
        remarks: when which of the followers' ``remarks`` was first true [s].
    """

    row: dict[Hashable, Any]
    traces: pd.DataFrame
    pushes: list[tuple[float, float]]
    states: NDArray[np.float64]
    log: PushLog
    env: HumanoidEnv
    limit: float
    remarks: Mapping[str, float]


def show_trial(
    battery: Battery,
    trial: int,
    candidates: Sequence[Candidate],
    folders: Mapping[str, Path],
    folder: Path,
    console: Console,
    *,
    seed: int,
    joint: str,
    video: bool,
    cut: Cut = Cut(),
) -> None:
    """Runs a trial again with each policy, prints its rows, draws traces of a joint.

    Writes ``trial_N.csv`` (targets, positions and torques of all joints, with ``video`` also
    ``trial_N.mp4``) into the folder of each policy, ``trial_N_JOINT.{png,pdf}`` of all into
    ``folder``.

    Args:
        battery: the definition.
        trial: its number.
        candidates: policies.
        folders: by name of a candidate, where its files go.
        folder: where the figure goes.
        console: to print on.
        seed: of the battery.
        joint: which is drawn.
        video: whether it is filmed.
        cut: which part of the time the film shows, and how fast.

    Raises:
        ValueError: if there is no such trial or joint.
    """
    traces: dict[str, pd.DataFrame] = {}
    pushes: list[tuple[float, float]] = []
    limits: list[float] = []
    for each in candidates:
        replay = run_trial(battery, each, trial, seed=seed, joint=joint)
        place = folders[each.name]
        place.mkdir(parents=True, exist_ok=True)
        what = sentence(replay.row, outcome_names(battery))
        console.print(f"trial {trial} of {battery.name}, {each.name}: {what}", soft_wrap=True)
        for key, value in replay.row.items():
            shown = f"{value:.4g}" if isinstance(value, float) else value
            console.print(f"  {key}: {shown}")
        replay.traces.to_csv(place / f"trial_{trial}.csv", index=False)
        if video:
            outcome = outcome_of(replay.row, outcome_names(battery))
            path = place / f"trial_{trial}.mp4"
            where = surroundings(each.env_cfg, battery, each.kept)
            name = f"trial {trial} of {battery.name}; {where}"
            label, when = labels([each.name])[0], battery.push_time
            _film(replay, label, name, outcome, path, console, cut=cut, push_time=when)
        renamed = {f"{key}/{joint}": key for key in ("target", "position", "torque")}
        traces[each.name] = replay.traces.rename(columns=renamed)
        pushes += [push for push in replay.pushes if push not in pushes]
        limits.append(replay.limit)
    traces = dict(zip(labels(list(traces)), traces.values(), strict=True))
    limit = limits[0] if len(set(limits)) == 1 else None  # others have other servos
    for ending in ("png", "pdf"):
        path = folder / f"trial_{trial}_{joint}.{ending}"
        trace_plot(traces, path, joint=joint, pushes=pushes, limit=limit)
        console.print(f"wrote {path}", soft_wrap=True)


def run_trial(
    battery: Battery, candidate: Candidate, trial: int, *, seed: int, joint: str
) -> Replay:
    """Runs a trial alone; it is the same as among the others.

    Raises:
        ValueError: if there is no such trial or joint.
    """
    states: list[NDArray[np.float64]] = []
    signals: list[NDArray[np.float32]] = []
    env = battery_env(battery, candidate.env_cfg, 1)[0].base_env
    joints, log, remarks = env.robot.joints, PushLog(1), dict[str, float]()
    remarking = [each.remarks for each in followers_of(battery) if hasattr(each, "remarks")]
    if joint not in joints:
        raise ValueError(f"joint must be one of {', '.join(joints)}, got {joint}.")

    def watch(base: HumanoidEnv, td: TensorDictBase) -> None:
        states.append(base.simulation.qpos[:1].numpy().copy())
        log.add(td)
        for said in remarking:
            for words, which in said(td).items():
                if which[0]:
                    remarks.setdefault(words, len(states) * env.control_dt)
        keys = ("target", "joint_position", "joint_torque")
        signals.append(np.concatenate([td[key][0].numpy() for key in keys]))

    (row,) = run_battery(
        battery,
        candidate.env_cfg,
        candidate.actor,
        seed=seed,
        servos=candidate.servos,
        only=[trial],
        watch=watch,
    ).to_dict("records")
    names = [f"{key}/{joint}" for key in ("target", "position", "torque") for joint in joints]
    traces = pd.DataFrame(np.stack(signals), columns=names)
    traces.insert(0, "time_s", env.control_dt * (1 + np.arange(len(traces))))
    pushes = _times(plan_pushes(battery, pd.DataFrame([row])), traces["time_s"].iloc[-1])
    servo = env.camera.model.actuator(joint)
    limit = float(servo.forcerange[1])
    return Replay(row, traces, pushes, np.stack(states), log, env, limit, remarks)


def _times(pushes: Pushes, end: float) -> list[tuple[float, float]]:
    """Begin and end of each push of one trial that begins before its end [s]."""
    real = (pushes.time[0] < end) & (pushes.force[0] != 0).any(-1)
    begin = pushes.time[0][real]
    return list(zip(begin.tolist(), (begin + pushes.duration[0][real]).tolist(), strict=True))


def _film(
    replay: Replay,
    label: str,
    column: str,
    outcome: str,
    path: Path,
    console: Console,
    *,
    cut: Cut,
    push_time: float,
) -> None:
    env, length = replay.env, float(replay.traces["time_s"].iloc[-1])
    every = round(frame(env) / env.control_dt)
    count = len(replay.states) // every
    pushed = replay.log.frames([every * (k + 1) for k in range(count)])
    begin = max(0.0, length - 1.5)
    if outcome == "fell" and np.isfinite(fall := float(replay.row["time_to_fall_s"])):
        begin = push_time + fall  # counted from when the battery pushes, whenever a push came
        outcome += " {when}"
    said: list[tuple[float, str, bool | None]] = [
        (time, f"{words} {{when}}", None) for words, time in replay.remarks.items()
    ]
    said.append((begin, outcome, not outcome.startswith(("fell", "stands bent"))))
    try:
        film(
            env.camera.model,
            {label: replay.states[every - 1 :: every]},
            [column],
            pushed,
            path,
            dt=frame(env),
            cut=cut,
            outcomes={label: [sorted(said, key=lambda each: each[0])]},
        )
        console.print(f"wrote {path}", soft_wrap=True)
    except RuntimeError as error:
        console.print(f"no video: {error}")


def outcome_of(row: Mapping[Hashable, Any], outcomes: Sequence[str]) -> str:
    """The word for how a trial ended: the first outcome that is true."""
    return next((name for name in outcomes if row.get(name)), "stands bent")


def sentence(row: Mapping[Hashable, Any], outcomes: Sequence[str]) -> str:
    """A trial in one line: how it was pushed, and what came of it.

    Args:
        row: of ``trials.csv``.
        outcomes: columns that say how it ended; the first true one is the word for it.
    """
    outcome = outcome_of(row, outcomes)
    if row["impulse"] == 0:
        return f"not pushed, {outcome}"
    push = f"I = {row['impulse']:.2f}, {row['force_n']:.1f} N for {row['duration_s']:g} s"
    if np.isfinite(row["direction_rad"]):
        push += f" toward {np.degrees(row['direction_rad']):.0f} degrees (0 forward, 90 left)"
    return f"{push} at {row['body']}, {outcome}"
