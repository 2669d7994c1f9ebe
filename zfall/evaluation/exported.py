"""An exported policy in battery planar: its network by onnxruntime, its world by dm_control.

It is given what the task measures, and its action is the task's; that its own targets are those
of the task is checked in every step.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from dm_control.mujoco import wrapper
from dm_control.rl import control
from omegaconf import DictConfig

from zfall.envs.dm_task import TableTask
from zfall.envs.tables import robot_of
from zfall.envs.transforms.observations.measured import read_measured
from zfall.evaluation.battery import arrange, battery_env, run_battery
from zfall.evaluation.definitions import Battery
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import plan_pushes, plan_trials, those_of
from zfall.evaluation.statistics import summarize
from zfall.policies.exported import ExportedPolicy
from zfall.simulation.dm_control import Physics


def run_exported(
    battery: Battery,
    env_cfg: DictConfig,
    policy: ExportedPolicy,
    *,
    seed: int = 0,
    only: Sequence[int] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> pd.DataFrame:
    """The trials of a planar battery one after the other.

    Args:
        battery: the definition.
        env_cfg: config of the env, as in ``recipes/env``.
        policy: what is exported.
        seed: of the battery.
        only: numbers of the trials to run; all if ``None``.
        progress: called with the number of trials done and their total.

    Returns:
        One row per trial, as ``run_battery`` gives it; and ``target_error`` [rad], the largest
        distance of the task's targets from those of the exported policy.

    Raises:
        ValueError: on an unknown trial, or if the task ends an episode before a trial is over.
    """
    env_cfg = env_cfg.copy()  # a trial ends by the battery's rules, not by the task's
    env_cfg.transforms.terminations = None
    trials = plan_trials(battery, robot_of(env_cfg).impulse_unit, seed)
    pushes = plan_pushes(battery, trials)
    env, start, push = battery_env(battery, env_cfg, 1)
    base = env.base_env
    physics = Physics.from_model(wrapper.MjModel(base.simulation.model))
    physics.robot = base.robot
    task = TableTask(env, physics, random=seed)
    face = control.Environment(physics, task, n_sub_steps=base.substeps)
    steps = round(battery.end_time / base.control_dt)
    rows = those_of(trials, only)
    results = []
    for done, trial in enumerate(rows.index):
        arrange(battery, trials.loc[[trial]], pushes[np.array([trial])], base, start, push)
        policy.reset()
        outcomes, now, error = Outcomes(base, battery), face.reset(), 0.0
        for step in range(steps):
            keys = [name for name in policy.sizes if name in task.outcome]
            seen = {key: read_measured(task.outcome, key)[0].numpy() for key in keys}
            action, _ = policy.step(seen)
            now = face.step(action)
            outcomes.update(task.outcome)
            off = task.outcome["target"][0].numpy() - policy.states["target"][0]
            error = max(error, float(np.abs(off).max()))
            if outcomes.settled.all():
                break
            if now.last() and step < steps - 1:
                raise ValueError(f"episodes must last {battery.end_time} s, one ended before.")
        results.append(outcomes.table().assign(target_error=error))
        progress(done + 1, len(rows))
    table = pd.concat(results, ignore_index=True)
    return pd.concat([rows.reset_index(drop=True), table], axis=1)


def agreement(battery: Battery, exported: pd.DataFrame, own: pd.DataFrame) -> str:
    """How the pushed trials of both ended, in a few lines: the same trials in the same order."""
    pushed = (exported["impulse"] > 0).to_numpy()
    theirs, ours = (trials["recovered"].to_numpy()[pushed] for trials in (exported, own))
    same, more, less = (theirs == ours).sum(), (theirs & ~ours).sum(), (ours & ~theirs).sum()
    lines = [
        f"{same} of {len(ours)} pushed trials end the same way, {more} are recovered from only as "
        f"exported, {less} only in zfall"
    ]
    for name, trials in (("as exported", exported), ("in zfall", own)):
        summary = summarize(battery, trials)
        lines.append(
            f"{name}: recovered {trials['recovered'][pushed].mean():.3f}, I50 mean "
            f"{summary['i50_mean']:.3f}, least {summary['i50_min']:.2f}, falls without a push "
            f"{summary['control_falls']} of {summary['control_n']}"
        )
    error = exported["target_error"].max()
    return "\n".join([*lines, f"targets are those of the task to {error:.1g} rad"])


def compare_planar(
    battery: Battery,
    env_cfg: DictConfig,
    actor: torch.nn.Module,
    folder: Path,
    follow: Callable[[str], Callable[[int, int], None]],
) -> str:
    """Puts what was exported and the policy to the same battery; writes ``planar.csv``.

    Args:
        battery: of kind ``Planar``.
        env_cfg: config of the env.
        actor: the policy.
        folder: of ``policy.onnx`` and ``policy.json``.
        follow: begins a bar of this name; what it returns is called with the work done and its
            total.

    Returns:
        Their ``agreement``.
    """
    policy = ExportedPolicy(folder)
    exported = run_exported(battery, env_cfg, policy, progress=follow("as exported"))
    own = run_battery(battery, env_cfg, actor, progress=follow("in zfall"))
    exported.assign(recovered_in_zfall=own["recovered"]).to_csv(folder / "planar.csv", index=False)
    return agreement(battery, exported, own)
