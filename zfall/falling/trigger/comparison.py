"""How early a trigger is, and how often it is wrong."""

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from zfall.falling.modes import KNEEL, ModeRule, in_danger, modes_over
from zfall.falling.trigger.history import History

HOLD = 0.04  # for which a switched policy's network must be sure [s]
_NEVER = 10**6  # [steps]
_THRESHOLDS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99)
_HOLDS, _RATES, _ANGLES = (0.04, 0.08, 0.2), (2.0, 4.0, np.inf), (0.3, 0.4, 0.5, 0.6, 0.7)


def comparison(history: History, probability: Tensor, control_dt: float) -> pd.DataFrame:
    """``table`` of the network, by threshold, and of the fixed rule, by its bounds.

    Args:
        history: K trials.
        probability: of a fall, by the network ``(K, T)``.
        control_dt: of the trials [s].
    """
    parts = [
        table("network", history, learned(probability, control_dt), control_dt),
        table("rule", history, ruled(history, control_dt), control_dt),
    ]
    return pd.concat(parts, ignore_index=True)


def learned(probability: Tensor, control_dt: float, *, hold: float = HOLD) -> dict[str, Tensor]:
    """Steps ``(K, T)`` bool at which the network has triggered, by threshold.

    Args:
        probability: of a fall ``(K, T)``.
        control_dt: of the trials [s].
        hold: for how long it must be above the threshold, as in ``SwitchedPolicy`` [s].
    """
    rule = _rule(hold, control_dt)
    return {f"{p:g}": _given_up(rule, probability > p) for p in _THRESHOLDS}


def _rule(hold: float, control_dt: float) -> ModeRule:
    return ModeRule(hold=max(1, round(hold / control_dt)), rest=_NEVER)


def _given_up(rule: ModeRule, danger: Tensor) -> Tensor:
    no = torch.zeros_like(danger.T)
    return modes_over(rule, danger.T, no, no).T >= KNEEL


def ruled(history: History, control_dt: float) -> dict[str, Tensor]:
    """Steps ``(K, T)`` bool at which the fixed rule has triggered, by tilt, rate and hold."""
    out = {}
    for hold in _HOLDS:
        rule = _rule(hold, control_dt)
        for rate in _RATES:
            for angle in _ANGLES:
                danger = in_danger(history.lean, history.rate, angle=angle, angular_velocity=rate)
                name = f"{angle:g} rad, {rate:g} rad/s, {hold:g} s"
                out[name] = _given_up(rule, danger)
    return out


def table(
    kind: str, history: History, triggered: dict[str, Tensor], control_dt: float
) -> pd.DataFrame:
    """A row for each setting of a trigger.

    Args:
        kind: of the trigger, ``network`` or ``rule``.
        history: K trials.
        triggered: by setting, steps ``(K, T)`` bool at which it has triggered.
        control_dt: of the trials [s].

    Returns:
        ``trigger``, ``setting``; ``detected``: share of the falls in which it triggered between
        the push's begin and the first touch, and not before; ``lead_s``: median time from trigger
        to touch in these, NaN without any; ``false_alarms``: share of the other trials that it
        gave up; ``alarms_per_hour``: how often it gives up in an hour [1/h] in which nobody has
        pushed yet.
    """
    rows = []
    steps = torch.arange(history.live.shape[1])
    touch = torch.where(history.live, _NEVER, steps).amin(1)
    begin = (~history.pushed).sum(1)  # the first step after the push has begun
    for name, state in triggered.items():
        first = torch.where(state, steps, _NEVER).amin(1)
        falls, stays = history.fell, ~history.fell
        seen = falls & (first < touch) & (first >= begin)
        alone = torch.minimum(first, begin).sum() * control_dt / 3600.0
        lead = ((touch - first)[seen].double() * control_dt).median() if seen.any() else torch.nan
        rows.append(
            {
                "trigger": kind,
                "setting": name,
                "detected": float(seen.sum() / falls.sum()),
                "lead_s": float(lead),
                "false_alarms": float((first[stays] < _NEVER).double().mean()),
                "alarms_per_hour": float((first < begin).sum() / alone),
            }
        )
    return pd.DataFrame(rows)
