"""How recovery falls off with the width of what is randomised."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from zfall.evaluation.definitions import Battery
from zfall.evaluation.statistics import summarize

LEAST = 0.02  # bound of a factor or a friction, which must stay positive


def widened(world: Any, width: float) -> Any:
    """A battery's world with all that is drawn in it ``width`` times as wide.

    Bounds under ``uniform`` move away from their middle, ``[c - width r, c + width r]``, the lower
    one to 0.02 at least; standard deviations under ``std`` are multiplied. All else stays.

    Args:
        world: a table of it.
        width: 0 draws nothing, 1 is the world as it is.
    """
    if not isinstance(world, Mapping):
        return world
    changed: dict[str, Any] = {}
    for key, value in world.items():
        if key == "uniform":
            middle, reach = 0.5 * (value[0] + value[1]), 0.5 * width * (value[1] - value[0])
            changed[key] = [max(LEAST, middle - reach), middle + reach]
        elif key == "std":
            changed[key] = {name: width * std for name, std in value.items()}
        else:
            changed[key] = widened(value, width)
    return changed


def sweep_table(battery: Battery, trials: Mapping[float, pd.DataFrame]) -> pd.DataFrame:
    """One row for each width.

    ``width``; ``I = SIZE`` for each impulse, the share recovered; ``i50_mean``; ``falls``, of
    ``control`` trials without a push; ``pushed``, trials for each impulse.

    Args:
        battery: the definition, of one level push in each trial.
        trials: with their outcomes, by width.
    """
    rows = []
    for width, outcome in trials.items():
        summary = summarize(battery, outcome)
        pushed = outcome[outcome["impulse"] > 0]
        rows.append(
            {"width": width}
            | {f"I = {size}": share for size, share in summary["success"].items()}
            | {"i50_mean": summary["i50_mean"], "falls": summary["control_falls"]}
            | {"control": summary["control_n"], "pushed": len(pushed) // len(summary["success"])}
        )
    return pd.DataFrame(rows)
