"""``summary.json``."""

import json
import math
from pathlib import Path
from typing import Any


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Writes ``summary.json``, in which what is not a number is null: JSON has no word for it."""
    (folder / "summary.json").write_text(json.dumps(_known(summary), indent=2, allow_nan=False))


def _known(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _known(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_known(entry) for entry in value]
    return None if isinstance(value, float) and math.isnan(value) else value
