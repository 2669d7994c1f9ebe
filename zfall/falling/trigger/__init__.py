"""Learns when a fall can no longer be avoided.

``record`` pushes a policy and labels every trial by its end, ``fit`` trains a ``FallNetwork`` on
part of them, ``calibrate`` makes its probabilities true on another part, and ``comparison`` says
on the rest how it does against fixed rules.
"""

from zfall.falling.trigger.comparison import HOLD, comparison, learned, ruled, table
from zfall.falling.trigger.history import History, labels, record, split, without_trigger
from zfall.falling.trigger.training import calibrate, fit, probabilities

__all__ = [
    "HOLD",
    "History",
    "calibrate",
    "comparison",
    "fit",
    "labels",
    "learned",
    "probabilities",
    "record",
    "ruled",
    "split",
    "table",
    "without_trigger",
]
