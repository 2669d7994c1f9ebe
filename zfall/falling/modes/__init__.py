"""When to recover, when to kneel, and when it is done.

``FallPredictor`` writes how likely a fall is, ``ModeMachine`` decides on the mode, ``StableHold``
stops the servos in the last one.
"""

from zfall.falling.modes.hold import StableHold
from zfall.falling.modes.machine import (
    KNEEL,
    MODES,
    RECOVER,
    RISE,
    STABLE,
    ModeMachine,
    ModeRule,
    ModeState,
    in_danger,
    modes_over,
    one_hot,
)
from zfall.falling.modes.predictor import FallPredictor

__all__ = [
    "KNEEL",
    "MODES",
    "RECOVER",
    "RISE",
    "STABLE",
    "FallPredictor",
    "ModeMachine",
    "ModeRule",
    "ModeState",
    "StableHold",
    "in_danger",
    "modes_over",
    "one_hot",
]
