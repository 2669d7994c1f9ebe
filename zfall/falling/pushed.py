"""Trials of a battery, all at once, whose pushes begin at any time."""

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from omegaconf import DictConfig
from rich.console import Console
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from zfall.envs.tables import robot_of
from zfall.envs.worlds import World
from zfall.evaluation.battery import BLOCK, arrange, battery_env, begin_streams, play
from zfall.evaluation.candidate import Candidate, load_candidate
from zfall.evaluation.definitions import Battery, load_battery
from zfall.evaluation.plans import Pushes, plan_pushes, plan_trials
from zfall.policies import load_policy
from zfall.terminal import QUIET, progress_bar

PUSH_TIME, SPREAD = 0.5, 3.0  # the first time of a push, and how much later it may come [s]


@cache
def world_of(name: str | None) -> World | None:
    """The hardware of a battery, by its name; ``None``: that of each env."""
    return None if name is None else load_battery(name).world


def check_world_name(name: str | None) -> None:
    """Refuses what is not the name of a battery that has hardware.

    Raises:
        ValueError: naming it.
    """
    if name is not None and world_of(name) is None:
        raise ValueError(f"world must be null or a battery with hardware, twin, got {name}.")


class PushedWorlds(NamedTuple):
    """An env with a trial in each of its N worlds; the last worlds repeat the last trial.

    Attributes:
        env: ready for a reset.
        trials: K rows, as ``plan_trials`` makes them; world ``i`` runs trial ``rows[i]``.
        rows: ``(N,)``.
        pushes: of the N worlds.
    """

    env: TransformedEnv
    trials: pd.DataFrame
    rows: np.ndarray
    pushes: Pushes

    def play(
        self, actor: torch.nn.Module | None, seconds: float, console: Console = QUIET
    ) -> Iterator[TensorDictBase]:
        """Runs all trials from their start, with a progress bar, and yields what follows each step.

        Args:
            actor: the policy; ``None`` for a baseline.
            seconds: how long.
            console: for the bar.
        """
        steps = round(seconds / self.env.base_env.control_dt)
        with progress_bar(console) as bar:
            yield from bar.track(
                play(self.env, actor, steps), total=steps, description="pushed trials"
            )


def pushed_worlds(
    battery: Battery,
    env_cfg: DictConfig,
    *,
    seed: int,
    servos: bool = True,
    control_arm: bool = True,
) -> PushedWorlds:
    """Worlds for all trials of a battery.

    Args:
        battery: the definition.
        env_cfg: config of the env.
        seed: of the trials, and of when a push begins, up to ``SPREAD`` after the battery's time.
        servos: whether the servos act at all.
        control_arm: whether there are trials without a push.
    """
    trials = plan_trials(battery, robot_of(env_cfg).impulse_unit, seed)
    if not control_arm:
        trials = trials[trials["impulse"] > 0].reset_index(drop=True)
    worlds = BLOCK * -(-len(trials) // BLOCK)
    env, begin, push = battery_env(battery, env_cfg, worlds, servos=servos)
    base = env.base_env
    rows = np.arange(worlds).clip(max=len(trials) - 1)
    begin_streams(base, seed, trials["trial"].iloc[rows])
    pushes = plan_pushes(battery, trials).later(SPREAD, base.physics_dt, seed)[rows]
    arrange(battery, trials.iloc[rows], pushes, base, begin, push)
    return PushedWorlds(env, trials, rows, pushes)


def pushed_policy(run: str, *, checkpoint: str = "last", change: Sequence[str] = ()) -> Candidate:
    """What is to be pushed, or watched.

    Args:
        run: a run folder, the name of a policy that ships or of a baseline, or the file of a
            checkpoint.
        checkpoint: of a run folder.
        change: values of the env to replace.

    Raises:
        ValueError: if there is none.
    """
    path = Path(run)
    if path.suffix == ".pt" and path.is_file():
        return load_candidate(load_policy(path), change=change)
    return load_candidate(run, checkpoint=checkpoint, change=change)
