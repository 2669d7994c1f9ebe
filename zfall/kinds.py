"""What an annotation says a value may be, in words and by class."""

from collections.abc import (
    Callable,
    Collection,
    Hashable,
    Iterable,
    Mapping,
    MutableMapping,
    Sequence,
    Set,
)
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NotRequired,
    Union,
    get_args,
    get_origin,
    is_typeddict,
)

from zfall.values import shown

TABLES = (dict, Mapping, MutableMapping)
LISTS = (list, tuple, set, frozenset, Sequence, Collection, Iterable, Set)


def described(kind: Any) -> str:
    """A kind in words."""
    origin, args = get_origin(kind) or kind, get_args(kind)
    if origin is Annotated:
        return described(args[0])
    if origin is NotRequired:
        return described(args[0])
    if origin in (Union, UnionType):
        return " or ".join(map(described, args))
    if origin is Literal:
        return " or ".join(shown(choice) for choice in args)
    names: dict[Any, str] = {
        bool: "true or false",
        int: "a whole number",
        float: "a number",
        str: "text",
    }
    names |= {NoneType: "null", None: "null", Any: "anything"}
    if isinstance(origin, Hashable) and origin in names:
        return names[origin]
    if is_callable(kind):
        return "a table with a _target_ and _partial_: true"
    if is_typeddict(kind) or origin in TABLES:
        return "a table"
    if origin in LISTS:
        return "a list"
    return f"a table with a _target_ that makes a {getattr(origin, '__name__', origin)}"


def is_live(kind: Any) -> bool:
    """Whether no value of a yaml is of this kind, only an object that a table makes."""
    if get_origin(kind) in (Union, UnionType):
        return all(map(is_live, get_args(kind)))
    return described(kind).startswith("a table with a _target_ that makes")


def is_ours(made: Any) -> bool:
    """Whether a class or function is of this package, so that we know who builds or calls it."""
    return (getattr(made, "__module__", None) or "").partition(".")[0] == "zfall"


def is_plain(kind: Any) -> bool:
    """Whether numbers, texts, flags and lists of them are all that is of a kind."""
    origin = get_origin(kind) or kind
    if origin in (Annotated, NotRequired):
        return is_plain(get_args(kind)[0])
    if origin in (Union, UnionType) or origin in LISTS:
        return all(map(is_plain, get_args(kind)))
    return origin in (bool, int, float, str, NoneType, None, Literal)


def is_open(kind: Any) -> bool:
    """Whether any value will do."""
    return kind in (Any, object)


def is_table(kind: Any) -> bool:
    """Whether a table of any keys is meant."""
    return (get_origin(kind) or kind) in TABLES


def is_callable(kind: Any) -> bool:
    """Whether what is meant is called later."""
    return (get_origin(kind) or kind) is Callable
