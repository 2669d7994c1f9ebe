"""The trials that a policy lost to the smallest pushes, and how to see each."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from zfall.commands import shell_line, shown_path

SHOWN = 8  # trials


def lost_trials(trials: pd.DataFrame, count: int = SHOWN) -> pd.DataFrame:
    """Those not recovered from, smaller pushes first, of equal ones those that fell sooner.

    Columns: ``trial``, ``I``, ``toward [deg]`` (0 forward, 90 left), ``at``, the push point,
    ``outcome``, ``fell after [s]`` of the push's begin.

    Args:
        trials: rows of ``trials.csv``.
        count: at most so many.
    """
    lost = trials[~trials["recovered"].astype(bool)]
    lost = lost.sort_values(["impulse", "time_to_fall_s", "trial"], kind="stable").head(count)
    columns = list(trials.columns)
    between = columns[columns.index("recovered") + 1 : columns.index("time_to_fall_s")]
    words = [name for name in between if name != "fell"] + ["fell"]
    outcomes = [
        next((word for word in words if bool(row[word])), "stands bent")
        for row in lost.to_dict("records")
    ]
    return pd.DataFrame(
        {
            "trial": lost["trial"].astype(int),
            "I": lost["impulse"],
            "toward [deg]": np.degrees(lost["direction_rad"]).round(),
            "at": lost["body"],
            "outcome": outcomes,
            "fell after [s]": lost["time_to_fall_s"],
        }
    )


def can_be_shown(trials: pd.DataFrame) -> bool:
    """Whether the trials are independent: those of a bisection follow from each other."""
    return {"trial", "recovered", "time_to_fall_s"} <= {*trials} and "round" not in trials


def film_line(run: Path, summary: Mapping[str, Any], setting: str, trial: int) -> str:
    """What to type to see a trial again: the same start, the same push, the same world.

    Args:
        run: its folder.
        summary: of the battery.
        setting: name of the folder of results.
        trial: its number.

    Returns:
        The line; empty if the results do not say how they were made, as older ones.
    """
    given = summary.get("given")
    if given is None and setting == summary["battery"]:
        given = [f"battery={setting}"]
    if given is None:
        return ""
    words = [f"run={shown_path(run)}", *given, f"trial={trial}", "video=true"]
    return shell_line("evaluate", *map(shlex.quote, words))
