"""The same trials twice: by the loop on a simulated bus, and by the fast path."""

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
import torch
from omegaconf import DictConfig

from zfall.deployment.log import Log
from zfall.deployment.loop import Settings, drive
from zfall.deployment.simulated import SimulatedBus
from zfall.evaluation.battery import run_battery
from zfall.evaluation.plans import plan_pushes, plan_trials
from zfall.evaluation.statistics import wilson
from zfall.policies.exported import ExportedPolicy


def dry_run(
    policy: ExportedPolicy,
    bus: SimulatedBus,
    *,
    seed: int = 0,
    only: Sequence[int] | None = None,
    settings: Settings = Settings(),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> pd.DataFrame:
    """Trials of a battery by the loop, one after the other, as fast as they go.

    Args:
        policy: what was exported.
        bus: in the battery's world.
        seed: of the battery.
        only: numbers of the trials to run; all if ``None``.
        settings: of the loop.
        progress: called with the number of trials done and their total.

    Returns:
        One row per trial, as ``run_battery`` gives it.
    """
    battery = bus.battery
    trials = plan_trials(battery, bus.base.robot.impulse_unit, seed)
    pushes = plan_pushes(battery, trials)
    numbers, rows = list(trials.index if only is None else only), []
    for done, trial in enumerate(numbers):
        bus.begin(trials.loc[[trial]], pushes[np.array([trial])], seed)
        log = Log(None, bus.joints)
        drive(policy, bus, seconds=battery.end_time, log=log, settings=settings, over=bus.over)
        rows.append(bus.outcomes.table())
        progress(done + 1, len(numbers))
    table = pd.concat(rows, ignore_index=True)
    return pd.concat([trials.loc[numbers].reset_index(drop=True), table], axis=1)


def compare(
    policy: ExportedPolicy,
    bus: SimulatedBus,
    env_cfg: DictConfig,
    actor: torch.nn.Module | None,
    *,
    seed: int = 0,
    only: Sequence[int] | None = None,
    settings: Settings = Settings(),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> pd.DataFrame:
    """``dry_run``, with the outcomes of the fast path as ``recovered_in_zfall``."""
    table = dry_run(policy, bus, seed=seed, only=only, settings=settings, progress=progress)
    own = run_battery(bus.battery, env_cfg, actor, seed=seed, only=only)
    return table.assign(recovered_in_zfall=own["recovered"].to_numpy())


def agreement(table: pd.DataFrame) -> list[str]:
    """A table in a few lines: rates by size of the push with Wilson's 95 % intervals.

    Args:
        table: of ``compare``.
    """
    lines = []
    for impulse, rows in [*table.groupby("impulse"), ("all", table)]:
        parts = []
        for name, column in (("drive", "recovered"), ("fast path", "recovered_in_zfall")):
            count = int(rows[column].sum())
            low, high = wilson(count, len(rows))
            share = count / len(rows)
            parts.append(f"{name} {count} of {len(rows)}, {share:.2f} ({low:.2f} to {high:.2f})")
        where = impulse if impulse == "all" else f"I = {impulse:g}"
        lines.append(f"{where}: recovered by {', by '.join(parts)}")
    same = int((table["recovered"] == table["recovered_in_zfall"]).sum())
    return [*lines, f"{same} of {len(table)} trials end the same way"]
