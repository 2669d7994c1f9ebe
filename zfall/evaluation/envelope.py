"""The largest push recovered from, by direction and push point."""

from collections.abc import Callable

import numpy as np
import pandas as pd

from zfall.evaluation.definitions import Battery, plan_trials


def run_envelope(
    battery: Battery, seed: int, run: Callable[[pd.DataFrame], pd.DataFrame], *, unit: float = 1.0
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Bisects the impulse of every cell, direction x push point, all at once.

    A cell recovers from an impulse if most of its ``starts`` do, the same ones at every impulse;
    whether it would fall at a smaller one again is not looked for.

    Args:
        battery: the definition, with a ``resolution``.
        seed: of the battery.
        run: runs a plan of trials, with the columns of ``plan_trials``.
        unit: impulse of dimensionless size 1 [N s].

    Returns:
        One row per cell: ``direction_rad``, ``body``, ``largest``, the largest impulse that was
        recovered from, 0 if none, and ``smallest_failed``, not a number if it stood the largest
        that is looked for; and all trials that it took, in rounds.
    """
    top = max(battery.impulses)
    resolution = battery.resolution or top
    whole = plan_trials(battery, unit, seed)
    pushed = whole[whole["impulse"] == top].reset_index(drop=True)
    cells = pushed[["direction_rad", "body"]].iloc[:: battery.starts].reset_index(drop=True)
    low, high = np.zeros(len(cells)), np.full(len(cells), top)
    rounds = []
    control = run(whole[whole["impulse"] == 0.0])
    rounds.append(control.assign(round=0))
    tried = np.full(len(cells), top)  # first whether it falls at all
    number, fails = 0, np.full(len(cells), False)
    while number == 0 or (high - low).max() > resolution + 1e-9:
        number += 1
        plan = pushed.assign(impulse=np.repeat(tried, battery.starts))
        outcome = run(plan)
        rounds.append(outcome.assign(round=number))
        share = outcome["recovered"].to_numpy().reshape(len(cells), battery.starts).mean(1)
        good = share > 0.5
        low = np.where(good, tried, low)
        high = np.where(good, high, tried)
        fails |= ~good
        tried = 0.5 * (low + high)
    table = cells.assign(largest=low, smallest_failed=np.where(fails, high, np.nan))
    return table, pd.concat(rounds, ignore_index=True)
