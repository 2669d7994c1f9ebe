"""Tables and summaries of a run folder, which may be a stranger's: damage is said in one line."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd

from zfall.errors import why_unfit

_REPAIR = "take another copy, or remove it."


def read_table(path: Path) -> pd.DataFrame:
    """The rows of a csv file.

    Raises:
        ValueError: if it is no table, naming the file.
    """
    try:
        return pd.read_csv(path)
    except ValueError as error:  # all errors of pandas and of text are
        raise ValueError(_refusal(path, "a table in csv", error)) from error


def read_summary(path: Path) -> dict[str, Any]:
    """The entries of a JSON file.

    Raises:
        ValueError: if it is no table in JSON, naming the file.
    """
    try:
        return dict(json.loads(path.read_text()).items())
    except (ValueError, AttributeError, RecursionError) as error:
        raise ValueError(_refusal(path, "a table in JSON", error)) from error


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Within it what was read from a file is used: errors say that it is not as it was written.

    Raises:
        ValueError: naming the file and the reason.
    """
    try:
        yield
    except (ValueError, LookupError, TypeError, AttributeError, StopIteration) as error:
        raise ValueError(_refusal(path, "as it was written", error)) from error


def _refusal(path: Path, rule: str, error: Exception) -> str:
    why = why_unfit(error)
    return f"{path} must be {rule}, it is damaged or of another kind ({why}): {_REPAIR}"
