"""An exported policy in battery planar, through onnxruntime and dm_control alone."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from dm_control.mujoco import wrapper
from dm_control.rl import control
from numpy.typing import NDArray
from omegaconf import DictConfig

from zfall.envs.dm_physics import Physics
from zfall.envs.dm_task import TableTask
from zfall.evaluation.battery import arrange, battery_env, robot_of
from zfall.evaluation.comparison import mcnemar
from zfall.evaluation.definitions import Battery, plan_pushes, plan_trials
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.statistics import summarize


class OnnxPolicy:
    """``policy.onnx`` with its memory.

    Args:
        path: of the file.
        memory_shape: as ``policy.json`` says; ``None`` without a memory.
    """

    def __init__(self, path: Path, memory_shape: Sequence[int] | None):
        import onnxruntime  # an extra of the package

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session: Any = onnxruntime.InferenceSession(str(path), options)
        self.memory_shape = memory_shape
        self.reset()

    def reset(self) -> None:
        """Forgets."""
        shape = self.memory_shape
        self.memory = None if shape is None else np.zeros(shape, dtype=np.float32)

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The action ``(J,)`` for an observation ``(D,)``."""
        inputs = {"observation": observation[None]}
        inputs |= {} if self.memory is None else {"memory": self.memory}
        action, *rest = self.session.run(None, inputs)
        self.memory = rest[0] if rest else None
        return action[0]


def run_exported(
    battery: Battery,
    env_cfg: DictConfig,
    policy: OnnxPolicy,
    *,
    seed: int = 0,
    only: Sequence[int] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> pd.DataFrame:
    """The trials of a planar battery one after the other, each until its end or its fall.

    Args:
        battery: the definition.
        env_cfg: config of the env, as in ``recipes/env``.
        policy: what is exported.
        seed: of the battery.
        only: numbers of the trials to run; all if ``None``.
        progress: is told the number of trials done and their total.

    Returns:
        One row per trial: what ``run_battery`` gives, but peaks end with the fall.

    Raises:
        ValueError: if the task limits its episodes to less than a trial.
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
    rows = trials if only is None else trials[trials["trial"].isin(only)]
    results = []
    for done, trial in enumerate(rows.index):
        arrange(battery, trials.loc[[trial]], pushes[np.array([trial])], base, start, push)
        policy.reset()
        outcomes, now = Outcomes(base, battery), face.reset()
        for _ in range(steps):
            now = face.step(policy(now.observation["observation"]))
            outcomes.update(task.outcome)
            if outcomes.fell.all():
                break
            if now.last():
                raise ValueError(f"episodes must last {battery.end_time} s, one ended before.")
        results.append(outcomes.table())
        progress(done + 1, len(rows))
    table = pd.concat(results, ignore_index=True)
    return pd.concat([rows.reset_index(drop=True), table], axis=1)


def agreement(battery: Battery, exported: pd.DataFrame, own: pd.DataFrame) -> str:
    """What both recovered from, in a few lines: of the same trials."""
    same = exported["recovered"].to_numpy() == own["recovered"].to_numpy()
    lines = [f"{same.sum()} of {len(same)} trials end alike"]
    for name, trials in (("onnxruntime and dm_control", exported), ("zfall", own)):
        summary = summarize(battery, trials)
        lines.append(
            f"{name}: recovered {trials['recovered'].mean():.3f}, I50 mean "
            f"{summary['i50_mean']:.3f}, least {summary['i50_min']:.2f}"
        )
    p = mcnemar(exported["recovered"], own["recovered"])
    return "\n".join([*lines, f"probability of such a difference by chance (McNemar): {p:.2f}"])
