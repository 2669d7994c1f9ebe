"""Bad input in one line: what the key is, what the rule, what was given."""

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

from hydra.errors import (
    ConfigCompositionException,
    HydraException,
    InstantiationException,
    OverrideParseException,
)
from hydra.utils import get_object
from omegaconf import DictConfig
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    InterpolationResolutionError,
    InterpolationToMissingValueError,
    OmegaConfBaseException,
)
from yaml import YAMLError

from zfall.moved import moved

# Of another actor's key that was left over, for instance.
_UNEXPECTED = re.compile(r"(.*) got an unexpected keyword argument '(\w+)'.*")
_CALLED = re.compile(r"(\w+)\(\) missing .* arguments?: 'td'.*")  # a term, when the table is read
# A number where a list or a table belongs, or the other way round.
_OTHER_KIND = re.compile(
    r".*'(int|float|str|bool|NoneType|ListConfig|DictConfig|list|dict)' "
    r"(object is not|is not iterable|object has no attribute|and 'int'|and 'float').*"
)
_RESOLVING = "ValueError raised while resolving interpolation: "
_NO_PLACE = re.compile(r"invalid literal for int\(\) with base 10: '(\w+)'")  # of a list
_KEY_FIRST = re.compile(r"[a-z_]\w*(\.\w+)+(:| [a-z])")
_MERGING = re.compile(r"Error merging override (.+?)=(.*)", re.DOTALL)
_NOT_LOADED = re.compile(r"Error loading '(\S+)': \w+\([\"'](.*)[\"']\).*")


# Those that say by themselves what to repair; of others the kind is said, too.
SPOKEN = (ValueError, OSError, HydraException, OmegaConfBaseException, YAMLError)


def in_one_line(error: BaseException) -> str:
    """What went wrong, without hydra's account of where."""
    if isinstance(error, InstantiationException):
        return _innermost(error)
    if isinstance(error, OverrideParseException):
        reason = str(error).partition("\n")[0]
        rule = (
            "must be KEY=VALUE as hydra reads it; quotes keep what has signs in it, KEY=['a.b=1']"
        )
        return _flat(f"{error.override} {rule}: {reason}.")
    if isinstance(error, ConfigCompositionException):
        if merged := _MERGING.fullmatch(str(error).strip()):
            return f"{merged[1]} must be of the kind that the yaml gives it, got {merged[2]}."
        return _not_there(error) or _flat(str(error))
    if isinstance(error, OmegaConfBaseException) and error.full_key:
        reason = _flat(str(error).split("\n")[0])
        if isinstance(error, InterpolationResolutionError | InterpolationToMissingValueError):
            if reason.startswith(_RESOLVING):  # what it would be made of says what is wrong
                return reason.removeprefix(_RESOLVING)
            rule = "must refer to a value that is there, got another"
            return f"{error.full_key} {rule}: {reason}."
        return f"{error.full_key} must be given, or of another kind: {reason}."
    if no_place := _NO_PLACE.fullmatch(str(error)):
        return f"a list has values 0, 1 and so on, none that is called {no_place[1]}."
    return _said(error)


@contextmanager
def named(place: str) -> Iterator[None]:
    """Puts a key in front of what goes wrong while something is made of its value.

    Raises:
        ValueError: from the error, whatever its kind; hydra's own, which name the key, stay.
    """
    try:
        yield
    except Exception as error:
        text = str(error)
        if "full_key: " in text or text.startswith(place):
            raise
        raise ValueError(at(place, in_one_line(error))) from error


def why_unfit(error: Exception) -> str:
    """What is wrong with something read from a file, of the error that using it raised."""
    return f"lacks {error}" if isinstance(error, KeyError) else in_one_line(error)


def at(place: str, reason: str) -> str:
    """A reason with the place in front, as one key if it begins with one itself."""
    return f"{place}{'.' if _KEY_FIRST.match(reason) else ': '}{reason}" if place else reason


def _said(error: BaseException) -> str:
    """The message of an error, with its kind if that says more."""
    text = _flat(str(error)) or "no message"
    return text if isinstance(error, SPOKEN) else f"{type(error).__name__}: {text}"


def check_keys(cfg: Mapping[Any, Any] | DictConfig, known: set[str], prefix: str = "") -> None:
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
        head, _, key = str(error).rpartition("\nfull_key: ")  # not of a cause that it quotes
        keys += [key] if head else []
        if error.__cause__ is None:
            break
        error = error.__cause__
    place = ".".join(keys)
    reason = _flat(str(error).split("\nfull_key:")[0])
    kind = "" if isinstance(error, SPOKEN) else f"{type(error).__name__}: "
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
    else:
        reason = f"{kind}{reason}"
    return at(place, reason)


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
    except (ImportError, ValueError, AttributeError) as error:
        flat = _flat(str(error))
        absent = _NOT_LOADED.fullmatch(flat)
        raise ValueError(
            f"{key} {not_found(*absent.groups() if absent else (path, flat))}"
        ) from error


def _flat(text: str) -> str:
    flat = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    flat = flat.partition(" Config search path: ")[0]
    # Hydra's advice, which makes a new key of one that is misspelt.
    return flat.replace("To append to your config use +", "Unless it is misspelt, write +")


def check_number(value: Any, name: str, holds: Callable[[float], bool], rule: str) -> None:
    """Refuses a value that is no number, or one that the rule does not hold for.

    Raises:
        ValueError: naming it.
    """
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and holds(value)):
        raise ValueError(f"{name} must {rule}, got {value}.")
