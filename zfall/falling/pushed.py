"""Trials of a battery, all at once, whose pushes begin in any physics step."""

from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from omegaconf import DictConfig
from torchrl.envs import TransformedEnv
from torchrl.modules.utils import get_primers_from_module

from zfall.envs.tables import robot_of
from zfall.evaluation.battery import BLOCK, arrange, battery_env, begin_streams
from zfall.evaluation.definitions import Battery
from zfall.evaluation.plans import Pushes, plan_pushes, plan_trials
from zfall.modules.actors import recurrent_keys

PUSH_TIME = 0.52  # [s], whole control steps of 20 and 40 ms; pushes begin somewhere in the last


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


def pushed_worlds(
    battery: Battery,
    env_cfg: DictConfig,
    actor: torch.nn.Module | None,
    *,
    seed: int,
    servos: bool = True,
    control_arm: bool = True,
) -> PushedWorlds:
    """Worlds for all trials of a battery.

    Args:
        battery: the definition.
        env_cfg: config of the env.
        actor: the policy that is to act in them; ``None`` for a baseline.
        seed: of the trials, and of when in a control step a push begins.
        servos: whether the servos act at all.
        control_arm: whether there are trials without a push.
    """
    trials = plan_trials(battery, robot_of(env_cfg).impulse_unit, seed)
    if not control_arm:
        trials = trials[trials["impulse"] > 0].reset_index(drop=True)
    worlds = BLOCK * -(-len(trials) // BLOCK)
    env, begin, push = battery_env(battery, env_cfg, worlds, servos=servos)
    if actor is not None and recurrent_keys(actor):
        env.append_transform(get_primers_from_module(actor))
    base = env.base_env
    rows = np.arange(worlds).clip(max=len(trials) - 1)
    begin_streams(base, seed, trials["trial"].iloc[rows])
    pushes = plan_pushes(battery, trials).sooner(base.control_dt, base.physics_dt, seed)[rows]
    arrange(battery, trials.iloc[rows], pushes, base, begin, push)
    return PushedWorlds(env, trials, rows, pushes)
