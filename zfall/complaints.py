"""What is wrong with a value of a yaml, found by the annotation of what takes it.

See ``zfall.values`` for the annotations. Plain Python ones count, too, strict about kinds: ``true``
is no number and ``1`` no flag. We do not take pydantic for it: a value may be a table from which
hydra builds something later, and messages name rule, value and repair.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from numbers import Integral, Real
from os import PathLike
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NotRequired,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

from zfall.configs import nodes_of
from zfall.kinds import (
    LISTS,
    TABLES,
    described,
    is_callable,
    is_live,
    is_open,
    is_ours,
    is_plain,
    is_table,
)
from zfall.values import INFINITE, Rule, shown

_MISSING = "???"


def complaint(value: Any, kind: Any, place: str) -> str | None:
    """What is wrong with a value, in one line; ``None`` if it is of the kind.

    Args:
        value: of plain containers; a table with a ``_target_`` stands for what it builds.
        kind: an annotation.
        place: full key of the value.
    """
    found = _complain(value, kind, place)
    return None if found is None else found.text


def check_table(table: Mapping[str, Any], keys: Any, place: str = "") -> None:
    """Refuses a table that is not what a ``TypedDict`` says.

    Raises:
        ValueError: on an unknown key, naming the nearest; one that is missing, or a value that is
            of another kind or against its rule.
    """
    if text := complaint(table, keys, place):
        raise ValueError(text)


def unknown_key(place: str, key: str, known: Iterable[str], owner: str = "") -> str:
    """That nothing takes a key, and which may be meant."""
    known = [str(name) for name in known]
    near = get_close_matches(key, known, n=1)
    hint = f"; did you mean {near[0]}?" if near else "."
    what = f"a parameter of {owner}" if owner else "a key of the config"
    return f"{joined(place, key)} is not {what} ({', '.join(known) or 'it has none'}){hint}"


def joined(place: str, key: object) -> str:
    """Full key of an entry."""
    return f"{place}.{key}" if place else str(key)


def is_node(value: Any) -> bool:
    """Whether a value is a table of which hydra builds something."""
    return isinstance(value, Mapping) and "_target_" in value


@dataclass(frozen=True)
class _Complaint:
    text: str
    depth: int = 0  # how far inside of the value; a broken rule lies deeper than another kind


def _must(place: str, rule: str, value: Any, depth: int = 0) -> _Complaint:
    return _Complaint(f"{place} must {rule.rstrip(',')}, got {shown(value)}.", depth)


def _complain(value: Any, kind: Any, place: str, depth: int = 0) -> _Complaint | None:
    extras: list[Any] = []
    if get_origin(kind) is Annotated:
        kind, *extras = get_args(kind)
    origin = get_origin(kind)
    if isinstance(value, str) and value == _MISSING:
        return _Complaint(f"{place} must be given, it has no default; got ???.", depth)
    if is_open(kind):
        return None
    if origin in (Union, UnionType):
        return _of_any(value, get_args(kind), place, depth)
    if is_node(value) and not is_typeddict(kind) and not is_table(kind):
        return _of_node(value, kind, place, depth)
    found = _of_kind(value, kind, place, depth, INFINITE in extras)
    if found is None:
        for rule in (extra for extra in extras if isinstance(extra, Rule)):
            if not rule.holds(value):
                return _must(place, rule.text, value, depth + 1)
    return found


def _of_any(value: Any, kinds: Sequence[Any], place: str, depth: int) -> _Complaint | None:
    found = [_complain(value, kind, place, depth) for kind in kinds]
    complaints = [each for each in found if each is not None]
    if len(complaints) < len(found):
        return None
    deepest = max(complaints, key=lambda each: each.depth)
    if deepest.depth > depth:  # of the right kind, but for something inside of it
        return deepest
    plain = [kind for kind in kinds if not is_live(kind)] or kinds
    rules = [_be(kind, value).removeprefix("be ") for kind in plain]
    return _must(place, f"be {' or '.join(dict.fromkeys(rules))}", value, depth)


def _of_node(value: Any, kind: Any, place: str, depth: int) -> _Complaint | None:
    """Whether a table is built at once or called later; what it builds is seen then."""
    if value.get("_partial_") and not is_callable(kind):
        if get_origin(kind) is tuple and Ellipsis not in get_args(kind):  # a part of what it takes
            entries = ", ".join(map(described, get_args(kind)))
            return _must(place, f"be a list, [{entries}]", value, depth + 1)
        return _Complaint(f"{place} must be built at once: take its _partial_ out.", depth + 1)
    return None


def _of_kind(value: Any, kind: Any, place: str, depth: int, infinite: bool) -> _Complaint | None:
    origin = get_origin(kind) or kind
    if origin is NotRequired:
        return _complain(value, get_args(kind)[0], place, depth)
    if is_typeddict(kind):
        return _of_table(value, kind, place, depth)
    if origin is Literal:
        if any(value == choice and type(value) is type(choice) for choice in get_args(kind)):
            return None
        return _must(place, f"be {described(kind)}", value, depth)
    if origin is float:
        return _of_number(value, place, depth, infinite)
    if origin in (bool, int, str, NoneType, None):
        wanted = NoneType if origin is None else origin
        whole = wanted is int and isinstance(value, Integral) and not isinstance(value, bool)
        return (
            None if whole or type(value) is wanted else _must(place, _be(kind, value), value, depth)
        )
    if is_callable(kind):
        return _must(place, "be a table with a _target_ and _partial_: true", value, depth)
    if not isinstance(origin, type):
        return None
    if origin in TABLES:
        return _of_mapping(value, kind, place, depth)
    if origin in LISTS:
        return _of_list(value, kind, origin, place, depth)
    return _of_class(value, origin, place, depth)


def _of_number(value: Any, place: str, depth: int, infinite: bool) -> _Complaint | None:
    if isinstance(value, bool) or not isinstance(value, Real):  # of NumPy, too
        return _must(place, "be a number", value, depth)
    try:
        number = float(value)
    except OverflowError:
        return _must(place, "be a number of at most 1e308", "one larger", depth + 1)
    if math.isnan(number) or (math.isinf(number) and not infinite):
        return _must(place, "be a number" if infinite else "be a finite number", value, depth + 1)
    return None


def _of_class(value: Any, kind: type, place: str, depth: int) -> _Complaint | None:
    """An object: a table gives one of ours; what stands for one of others, we cannot tell."""
    if issubclass(kind, PathLike):
        return None if isinstance(value, str) else _must(place, "be a path", value, depth)
    if not _plain(value) or not is_ours(kind):
        return None
    return _must(place, f"be {described(kind)}", value, depth)


def _of_mapping(value: Any, kind: Any, place: str, depth: int) -> _Complaint | None:
    if not isinstance(value, Mapping):
        return _must(place, f"be {described(kind)}", value, depth)
    of_key, of_value = get_args(kind) or (Any, Any)
    for key, entry in value.items():
        if found := _complain(key, of_key, f"the key {key!r} of {place}", depth + 1):
            return found
        if found := _complain(entry, of_value, joined(place, key), depth + 1):
            return found
    return None


def _of_list(value: Any, kind: Any, origin: type, place: str, depth: int) -> _Complaint | None:
    if not isinstance(value, list | tuple):
        return _must(place, _be(kind, value), value, depth)
    inside = get_args(kind) or (Any, Ellipsis)
    if issubclass(origin, tuple) and inside[1:] != (Ellipsis,):
        if len(value) != len(inside):
            return _must(place, f"be a list of {len(inside)}", value, depth + 1)
        kinds = list(inside)
    else:
        kinds = [inside[0]] * len(value)
    for number, (entry, of_entry) in enumerate(zip(value, kinds, strict=True)):
        if found := _complain(entry, of_entry, joined(place, number), depth + 1):
            return found
    return None


def _of_table(value: Any, kind: Any, place: str, depth: int) -> _Complaint | None:
    hints = get_type_hints(kind, include_extras=True)
    if not isinstance(value, Mapping):
        return _must(place, f"be a table of {', '.join(hints)}", value, depth)
    for key in map(str, value):
        if key not in hints:
            return _Complaint(unknown_key(place, key, hints), depth + 1)
    for key, of_value in hints.items():
        if key in value:
            if is_plain(of_value):
                for node, _ in nodes_of(value[key], joined(place, key)):
                    return _must(node, "be plain, as nothing is built here", "a _target_", depth)
            if found := _complain(value[key], of_value, joined(place, key), depth + 1):
                return found
        elif key in kind.__required_keys__:
            text = f"{joined(place, key)} must be given, {described(of_value)}; it is not there."
            return _Complaint(text, depth + 1)
    return None


def _be(kind: Any, value: Any) -> str:
    """Rule of a kind, with the repair where a single value stands for a list."""
    if get_origin(kind) is Annotated:
        return _be(get_args(kind)[0], value)
    origin = get_origin(kind) or kind
    if origin in LISTS:
        no_repair = value is None or isinstance(value, Mapping)
        return "be a list" if no_repair else f"be a list, [{shown(value)}],"
    return f"be {described(kind)}"


def _plain(value: Any) -> bool:
    return value is None or isinstance(value, bool | int | float | str | list | tuple)
