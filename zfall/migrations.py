"""What stored configs say in older words, and what in them changes no result.

A result is found by what its config means (``zfall.meaning``). Whoever changes a yaml adds a line:

- a new key of a yaml: what was done without it, to ``MISSING``. Two kinds of keys need no line:
  a new argument of a class or function whose default is what was done before, and a key that is
  ``null``, ``{}`` or ``[]`` in a table without a ``_target_``.
- another name of a key: ``RENAMED``; another place of a class or function: ``zfall.moved``.
- a key that is gone: the value that means what is done today, to ``MISSING``.

A key is written in full, with ``*`` for any one name: ``optimizer.lr``, ``auxiliary_losses.*.std``,
``env.transforms.*.before``. A battery's begin with its name: ``battery.planar.starts``. An argument
may also be named by what takes it, wherever that stands: ``torch.optim.Adam.lr``.
"""

from typing import Any

_PLANAR, _KNEEL = "zfall.evaluation.kinds.planar.Planar", "zfall.falling.kneel_battery.Kneel"
_MEASURES = [
    "zfall.evaluation.strategies.Strategies",
    "zfall.evaluation.effort.Effort",
    "zfall.falling.kneeling.Kneeling",
]

# Key: what a config without it means. The date is that of the change.
MISSING: dict[str, Any] = {
    "alike": 1,  # 2026-11-26: every world begins by itself
    "stages": {},  # 2026-11-27: there was one part
    "statistics_batches": 0,  # 2026-11-27: the first batch was learned from with statistics of 0, 1
    "battery.planar.kind": _PLANAR,  # 2026-11-27: the kind followed from which numbers were given
    "battery.kneel.kind": _KNEEL,  # 2026-11-27
    "battery.*.measures": _MEASURES,  # 2026-11-27: all batteries measured the same
}

# Old key: its new name; one with dots is a full key, at another place.
RENAMED: dict[str, str] = {}

# Digest of a file or robot: a later one of the same content, written in another way.
SAME_CONTENT: dict[str, str] = {}

# Key: why it changes no result.
IRRELEVANT: dict[str, str] = {
    "name": "only reports and loggers show it",
    "logger": "what is logged is not read",
    "showcase": "training goes on as if nobody looked",
    "trust": "which modules may be read, not what they do",
    "checkpoint_every": "the last update is saved in any case, and that policy is tested",
    "groups": "worlds take turns; of another number only the random numbers differ",
    "launch": "several processes learn the same as one, but for the last digits",
    "device": "where it is computed, not what",
    "optimizer.fused": "the same step; the last digits are rounded in another order",
    "optimizer.foreach": "as optimizer.fused",
}
