"""Bad input in one line: what the key is, what the rule, what was given."""

import re
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from typing import Any

from hydra.errors import ConfigCompositionException, InstantiationException
from hydra.utils import get_object
from omegaconf import DictConfig, ListConfig
from omegaconf.errors import ConfigAttributeError, ConfigKeyError

from zfall.moved import moved

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
    if new := moved(target):
        reason = f"it moved to {new}"
    return f"must name something that Python can import, got {target}: {reason}."


def object_at(path: str, key: str) -> Any:
    """What a dotted path in a yaml names: a class or a function.

    Args:
        path: the dotted path.
        key: where it stands, for the error.

    Raises:
        ValueError: if it leads nowhere.
    """
    try:
        return get_object(path)
    except ImportError as error:
        flat = _flat(str(error))
        absent = _NOT_LOADED.fullmatch(flat)
        raise ValueError(f"{key} {not_found(*absent.groups()) if absent else flat}") from error


def _flat(text: str) -> str:
    flat = " ".join(text.split())
    flat = flat.partition(" Config search path: ")[0]
    # Hydra's advice, which makes a new key of one that is misspelt.
    return flat.replace("To append to your config use +", "Unless it is misspelt, write +")


def check_whole(cfg: DictConfig, keys: Iterable[str], least: int = 0) -> None:
    """Refuses what is no whole number, or less than ``least``, naming the key."""
    for key in keys:
        if type(cfg[key]) is not int:
            raise ValueError(f"{key} must be a whole number, got {cfg[key]}.")
        check_number(cfg[key], key, lambda x: x >= least, f"be at least {least}")


def check_lists(cfg: DictConfig, keys: Iterable[str]) -> None:
    """Refuses what is no list, naming the key; ``null`` is left to its reader."""
    for key in keys:
        if cfg.get(key) is not None and not isinstance(cfg[key], ListConfig):
            raise ValueError(f"{key} must be a list, [{cfg[key]}], got {cfg[key]}.")


def check_flags(cfg: DictConfig, keys: Iterable[str]) -> None:
    """Refuses what is neither true nor false, naming the key."""
    for key in keys:
        if not isinstance(cfg[key], bool):
            raise ValueError(f"{key} must be true or false, got {cfg[key]}.")


def check_number(value: Any, name: str, holds: Callable[[float], bool], rule: str) -> None:
    """Refuses a value that is no number, or one that the rule does not hold for.

    Raises:
        ValueError: naming it.
    """
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and holds(value)):
        raise ValueError(f"{name} must {rule}, got {value}.")
