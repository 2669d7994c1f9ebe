"""How recovery falls off with the width of what is randomised."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from zfall.evaluation.definitions import Battery
from zfall.evaluation.statistics import summarize
from zfall.simulation.parameters import ANY_NUMBER, RANGES

Ranges = Mapping[str, tuple[float, float]]
LEAST = 0.02  # smallest value of a factor or a friction, which must stay positive


def widened(world: Any, width: float, ranges: Ranges = RANGES, name: str = "") -> Any:
    """A battery's world with all that is drawn in it ``width`` times as wide.

    Bounds under ``uniform`` move away from their middle, ``[c - width r, c + width r]``, those
    under ``log_uniform`` likewise in their logarithm, as far as the physics bears; a parameter that
    cannot be negative stays at least 0.02. Standard deviations under ``std`` and ``normal`` are
    multiplied. All else stays, delays and backlash among them.

    Args:
        world: a table of it.
        width: 0 draws nothing, 1 is the world as it is.
        ranges: what the physics bears, ``env.parameters.ranges``.
        name: of the table, which is that of a parameter.
    """
    if not isinstance(world, Mapping):
        return world
    changed: dict[str, Any] = {}
    for key, value in world.items():
        if key in ("uniform", "std") and isinstance(value, Mapping):  # of each quantity
            changed[key] = {quantity: width * size for quantity, size in value.items()}
        elif key == "uniform":
            changed[key] = _cut(_spread(value, width), value, ranges.get(name, ANY_NUMBER))
        elif key == "log_uniform":
            changed[key] = np.exp(_spread(np.log(value), width)).round(12).tolist()
        elif key == "normal":
            changed[key] = [value[0], width * value[1]]
        else:
            changed[key] = widened(value, width, ranges, key)
    return changed


def _spread(bounds: Sequence[float], width: float) -> list[float]:
    low, high = bounds
    middle, reach = 0.5 * (low + high), 0.5 * width * (high - low)
    return [round(middle - reach, 12), round(middle + reach, 12)]


def _cut(bounds: list[float], given: Sequence[float], within: tuple[float, float]) -> list[float]:
    """Bounds within what the physics bears of a parameter."""
    least, most = within
    if least >= 0:
        least = max(least, min(LEAST, given[0]))
    return [max(least, bounds[0]), min(most, bounds[1])]


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
