"""How a recipe starts and ends: errors in one line, exit codes."""

import inspect
import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from traceback import walk_tb
from typing import Annotated, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from zfall.cluster.launcher import register
from zfall.commands import remove_if_empty
from zfall.complaints import check_table
from zfall.configs import config_folder, plain_containers
from zfall.errors import SPOKEN, in_one_line
from zfall.help import help_of
from zfall.static_checks import check_numbers
from zfall.values import Count, Name, Rule

TRACEBACK = "ZFALL_TRACEBACK"  # set to 1 it shows where an error came from


Checkpoint = Name  # of a run folder: last, best, or a stage that is over
Run = Annotated[str, Rule("be a run folder or a name", lambda x: bool(x.strip()) and "\0" not in x)]
Changes = Sequence[Name]
Starts = Count | None


def start(main: Callable[[], None]) -> None:
    """Runs a recipe's main from the shell, hydra's own errors included."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        module = sys.modules[main.__module__]
        script = Path(str(module.__file__)).with_suffix("").relative_to(config_folder())
        print(help_of(".".join(script.parts), module.__doc__ or ""))
        return
    os.environ["HYDRA_FULL_ERROR"] = "1"  # else hydra prints errors its own way, on many lines
    logging.getLogger("hydra.utils").setLevel(logging.CRITICAL)  # it also logs what it raises
    logging.getLogger("OpenGL").setLevel(logging.WARNING)  # tells of each part that is optional
    with one_line_errors(SPOKEN):
        register()
        try:
            composed_first(main)
        except KeyboardInterrupt:
            print("stopped", file=sys.stderr)
            raise SystemExit(130) from None


def composed_first(main: Callable[[], None]) -> None:
    """Runs a recipe's main; what goes wrong before its first line lies in the words given.

    Raises:
        ValueError: naming them, if hydra does not.
    """
    HydraConfig.instance().cfg = None  # of a recipe before in this process
    begin = inspect.unwrap(main).__code__
    try:
        main()
    except Exception as error:
        began = any(frame.f_code is begin for frame, _ in walk_tb(error.__traceback__))
        if began or isinstance(error, SPOKEN):
            raise
        words = " ".join(word for word in sys.argv[1:] if "=" in word or word.startswith("~"))
        raise ValueError(
            f"{words or 'the config'} must be keys and values that hydra can put together, got "
            f"{in_one_line(error)}; an entry of a list is changed by giving the whole list."
        ) from error


@contextmanager
def one_line_errors(kinds: tuple[type[Exception], ...] = (Exception,)) -> Iterator[None]:
    """Ends the program with exit code 1 and one line for errors that the user can repair.

    While a recipe sets up what a config says that may be any error: the line then names its kind,
    and how to see where it came from. The folder that hydra has made goes too, if it is empty.

    Args:
        kinds: of errors; once a recipe works, others than those that speak for themselves are
            faults of the program, and stay what they are.
    """
    try:
        yield
    except kinds as error:
        if os.environ.get(TRACEBACK) == "1":
            raise
        if HydraConfig.initialized():
            with suppress(OmegaConfBaseException):  # it failed before it had a folder
                remove_if_empty(Path(HydraConfig.get().runtime.output_dir))
        line = in_one_line(error)
        where = "" if isinstance(error, SPOKEN) else f" ({TRACEBACK}=1 shows where it came from)"
        raise SystemExit(f"error: {line}{where}") from None


def check_recipe(cfg: DictConfig, keys: Any) -> None:
    """Refuses a composed config that is not what the ``TypedDict`` of a recipe says, and any NaN.

    Raises:
        ValueError: naming the key.
    """
    config = plain_containers(cfg)
    check_numbers(config)
    check_table(config, keys)


def choice(group: str) -> str | None:
    """The option that was chosen from a group of yaml files; ``None`` if none was."""
    chosen = HydraConfig.get().runtime.choices.get(group)
    return None if chosen in (None, "null") else str(chosen)


def loading(cfg: DictConfig) -> dict[str, Any]:
    """What the keys env, servo, checkpoint and change say of how candidates are loaded."""
    task = {"task": cfg.env} if choice("env") else {}
    return {**task, "checkpoint": cfg.checkpoint, "change": [*servo_change(), *cfg.change]}


def given_but(*keys: str) -> list[str]:
    """What the shell gave to this recipe, folders of configs too, without these keys."""
    config = HydraConfig.get()
    overrides = config.overrides.task
    words = [word for word in overrides if word.partition("=")[0].lstrip("+~") not in keys]
    sources = [
        each.path for each in config.runtime.config_sources if each.provider == "command-line"
    ]
    return [*words, *(f"--config-dir={path}" for path in sources)]


def servo_change() -> list[str]:
    """Changes of an env that ``robot=NAME`` and ``servo=NAME`` ask for, see ``tables.changed``."""
    return [f"{group}={name}" for group in ("robot", "servo") if (name := choice(group))]
