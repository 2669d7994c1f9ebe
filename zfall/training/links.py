"""``stage:NAME`` in the config of a later stage: the file that stage NAME came to."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

LINK = "stage:"  # and the name of one: what that came to


def is_link(value: Any) -> bool:
    """Whether a value names what a stage came to."""
    return isinstance(value, str) and value.startswith(LINK)


def filled(value: Any, folder: Path, files: Mapping[str, str]) -> Any:
    """A config with files in the folder of the run for the stages that it names.

    Args:
        value: plain containers.
        folder: of the run.
        files: of the stages before, by name, within that folder.
    """
    if isinstance(value, Mapping):
        return {key: filled(each, folder, files) for key, each in value.items()}
    if isinstance(value, list):
        return [filled(each, folder, files) for each in value]
    return str(folder / files[value.removeprefix(LINK)]) if is_link(value) else value


def check_links(value: Any, before: Mapping[str, Any], place: str) -> None:
    """Refuses values that name a stage which is not there, or not over.

    Args:
        value: plain containers.
        before: the stages before, by name.
        place: key of the value, for messages.

    Raises:
        ValueError: naming the key.
    """
    if isinstance(value, Mapping | list):
        entries = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, each in entries:
            check_links(each, before, f"{place}.{key}")
    elif is_link(value) and value.removeprefix(LINK) not in before:
        there = f"a stage before it, {', '.join(before)}" if before else "no stage, it is the first"
        raise ValueError(f"{place} must name {there}, got {value}.")
