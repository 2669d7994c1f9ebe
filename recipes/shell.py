"""How a recipe starts and ends: errors in one line, exit codes."""

import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, InstantiationException
from omegaconf.errors import OmegaConfBaseException

from zfall.commands import remove_if_empty
from zfall.errors import in_one_line


def start(main: Callable[[], None]) -> None:
    """Runs a recipe's main from the shell, hydra's own errors included."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # else hydra prints errors its own way, on many lines
    logging.getLogger("hydra.utils").setLevel(logging.CRITICAL)  # it also logs what it raises
    with one_line_errors():
        try:
            main()
        except KeyboardInterrupt:
            print("stopped", file=sys.stderr)
            raise SystemExit(130) from None


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Ends the program with exit code 1 and one line for errors that the user can repair.

    The folder that hydra has made for it goes too, if it is empty.
    """
    known = (InstantiationException, ValueError, OSError, HydraException, OmegaConfBaseException)
    try:
        yield
    except known as error:
        if HydraConfig.initialized():
            with suppress(OmegaConfBaseException):  # it failed before it had a folder
                remove_if_empty(Path(HydraConfig.get().runtime.output_dir))
        raise SystemExit(f"error: {in_one_line(error)}") from None


def choice(group: str) -> str | None:
    """The option that was chosen from a group of yaml files; ``None`` if none was."""
    chosen = HydraConfig.get().runtime.choices.get(group)
    return None if chosen in (None, "null") else str(chosen)


def servo_change() -> list[str]:
    """The change of an env that ``servo=NAME`` asks for, see ``zfall.envs.tables.changed``."""
    chosen = choice("servo")
    return [] if chosen is None else [f"servo={chosen}"]
