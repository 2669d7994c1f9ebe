"""The values of a study, each of its kind."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from zfall.errors import check_number

_FILE_NAME = re.compile(r"\w[\w+.-]{0,99}")
_TABLES = ("rows", "row_seeds", "tests", "tested_with")


def check_values(study: Mapping[str, Any]) -> None:
    """Refuses a study without runs, and values of another kind than it has.

    Args:
        study: its values by their names.

    Raises:
        ValueError: naming the key, the rule and the value.
    """
    if not (isinstance(name := study["name"], str) and _FILE_NAME.fullmatch(name)):
        raise ValueError(
            "study.name must be the name of a file, letters, digits and _ - + . with none of the "
            f"last three in front, such as actor_2, got {name!r}."
        )
    for key in _TABLES:
        if not isinstance(study[key], Mapping):
            raise ValueError(f"study.{key} must be a table, NAME: VALUE, got {study[key]}.")
    rows, battery = study["rows"], study["battery"]
    if not rows:
        raise ValueError(f"study.rows must be at least one NAME: [OVERRIDES], got {rows}.")
    if not isinstance(battery, Mapping) or "name" not in battery:
        raise ValueError(f"study.battery must be {{name: ..., ...}}, got {battery}.")
    for key, values in (_lists_of(study, "base", "rows", "tests")).items():
        if not all(isinstance(override, str) for override in values):
            raise ValueError(f"{key} must be a list of overrides, KEY=VALUE, got {values}.")
    for key, values in (_lists_of(study, "seeds", "row_seeds")).items():
        whole = all(type(seed) is int and seed >= 0 for seed in values)
        if not values or not whole or len(set(values)) < len(values):
            raise ValueError(f"{key} must be whole numbers from 0 on, each once, got {values}.")
    for row, table in study["tested_with"].items():
        if not isinstance(table, Mapping) or "_target_" not in table:
            raise ValueError(
                f"study.tested_with.{row} must be a table with a _target_, got {table}."
            )
    for key in ("row_seeds", "tested_with"):
        for row in study[key]:
            if row not in rows:
                names = ", ".join(map(str, rows))
                raise ValueError(f"study.{key} must name rows ({names}), got {row}.")
    frames = study["total_frames"]
    check_number(frames, "study.total_frames", lambda x: 0 < x < math.inf, "be a positive number")


def _lists_of(study: Mapping[str, Any], *keys: str) -> dict[str, Sequence[Any]]:
    """The lists under some keys, by the full key of each; tables hold one for each name."""
    found: dict[str, Any] = {}
    for key in keys:
        value = study[key]
        table = (
            {f".{name}": each for name, each in value.items()} if key in _TABLES else {"": value}
        )
        found |= {f"study.{key}{name}": each for name, each in table.items()}
    for key in [key for key, each in found.items() if each is None]:
        if key.startswith("study.tests."):  # each training's own world
            del found[key]
    for key, each in found.items():
        if isinstance(each, str) or not isinstance(each, Sequence):
            raise ValueError(f"{key} must be a list, got {each}.")
    return found
