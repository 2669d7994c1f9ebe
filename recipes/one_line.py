"""Bad input in one line: what the key is, what the rule, what was given."""

import logging
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.errors import ConfigCompositionException, HydraException, InstantiationException
from omegaconf import DictConfig
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

# Of another actor's key that was left over, for instance.
_UNEXPECTED = re.compile(r"(.*) got an unexpected keyword argument '(\w+)'.*")
_CALLED = re.compile(r"(\w+)\(\) missing .* arguments?: 'td'.*")  # a term, when the table is read
# A number where a list or a table belongs, or the other way round.
_OTHER_KIND = re.compile(
    r".*'(int|float|str|bool|NoneType|ListConfig|DictConfig|list|dict)' "
    r"(object is not|is not iterable|object has no attribute|and 'int'|and 'float').*"
)
_NO_PLACE = re.compile(r"invalid literal for int\(\) with base 10: '(\w+)'")  # of a list
_NOT_LOADED = re.compile(r"Error loading '(\S+)': \w+\([\"'](.*)[\"']\).*")


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


def shell_line(recipe: str, *arguments: str) -> str:
    """What to type to start a recipe with the Python that runs now."""
    return " ".join([shown_path(Path(sys.executable)), "-m", f"recipes.{recipe}", *arguments])


def shown_path(path: Path) -> str:
    """A path as short as it can be from here."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def remove_if_empty(folder: Path) -> None:
    """Removes what hydra made before it was known whether anything would be put into it."""
    with suppress(OSError):  # it holds something
        folder.rmdir()


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


def in_one_line(error: BaseException) -> str:
    """What went wrong, without hydra's account of where."""
    if isinstance(error, InstantiationException):
        return _innermost(error)
    if isinstance(error, ConfigCompositionException):
        return _not_there(error) or _flat(str(error))
    if no_place := _NO_PLACE.fullmatch(str(error)):
        return f"a list has values 0, 1 and so on, none that is called {no_place[1]}."
    return _flat(str(error))


def check_keys(cfg: DictConfig, known: set[str], prefix: str = "") -> None:
    """Refuses keys that nothing reads.

    Raises:
        ValueError: naming the key and the nearest known one.
    """
    for key in map(str, cfg):
        if key not in known:
            raise ValueError(_unknown(prefix + key, key, sorted(known)))


def _unknown(full_key: str, key: str, known: list[str]) -> str:
    near = get_close_matches(key, known, n=1)
    hint = f"; did you mean {near[0]}?" if near else "."
    return f"{full_key} is not a key of the config ({', '.join(known)}){hint}"


def _not_there(error: ConfigCompositionException) -> str | None:
    """What a key from the shell that the config does not have may be meant to be."""
    cause = error.__cause__
    if not isinstance(cause, (ConfigAttributeError, ConfigKeyError)):
        return None
    if not isinstance(cause.parent_node, DictConfig) or cause.full_key is None:
        return None
    names = [str(key) for key in cause.parent_node if not str(key).startswith(("_", "hydra"))]
    if not names:  # a single value
        return None
    return f"{_unknown(cause.full_key, str(cause.key), names)} A new one begins with a +."


def _innermost(error: BaseException) -> str:
    """Full key and reason of the error at the end of hydra's chain of causes."""
    keys = []
    while isinstance(error, InstantiationException):
        head, _, key = str(error).rpartition("full_key: ")
        keys += [key] if head else []
        if error.__cause__ is None:
            break
        error = error.__cause__
    place = ".".join(keys)
    reason = _flat(str(error).split("\nfull_key:")[0])
    unknown = _UNEXPECTED.fullmatch(reason)
    if unknown and place:
        function, key = unknown.groups()
        reason = (
            f"{function} takes no {key}; if the config gives it, '~{place}.{key}' takes it out."
        )
    elif called := _CALLED.fullmatch(reason):
        reason = f"{called[1]} is called in every step: beside its _target_ say _partial_: true."
    elif absent := _NOT_LOADED.fullmatch(reason):
        reason = f"_target_ {not_found(*absent.groups())}"
    elif place and _OTHER_KIND.fullmatch(reason):
        reason = f"a value may be of another kind than it takes: {reason}."
    return f"{place}: {reason}" if place else reason


def not_found(target: str, reason: str) -> str:
    """Rule, value and reason for a dotted path that leads nowhere."""
    module, _, name = target.rpartition(".")
    if reason.endswith(f"'{module}' is not a package"):  # Python looked for one to go on in
        reason = f"{module} has no {name}"
    return f"must name something that Python can import, got {target}: {reason}."


def _flat(text: str) -> str:
    flat = " ".join(text.split())
    flat = flat.partition(" Config search path: ")[0]
    # Hydra's advice, which makes a new key of one that is misspelt.
    return flat.replace("To append to your config use +", "Unless it is misspelt, write +")
