"""What a config means: two that are written in other words, and train or test the same, are equal.

``meaning`` brings a config into a normal form. Of two configs, whether from today's yaml or stored
by an earlier version:

- older names of keys, classes and functions are replaced by today's,
- a key that is missing has the value that it meant before it was there,
- an argument that is its default, and an empty entry of a table, are left out,
- what names a file counts by the content of the file,
- keys that change no result are left out,
- numbers are compared by value, 1 as 1.0.

``zfall.migrations`` has the tables.
"""

import inspect
import json
import math
import sys
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from functools import cache
from types import MappingProxyType
from typing import Any

from zfall import migrations
from zfall.moved import moved

Tree = dict[str | int, Any]  # tables by name, lists by number
_PLAIN = (bool, int, float, str, list, tuple, dict, type(None))  # what a yaml can give
NOTHING: Mapping[str, str] = MappingProxyType({})


def meaning(config: Mapping[str, Any], contents: Mapping[str, str] = NOTHING) -> dict[str, str]:
    """The normal form of a config, by full key.

    Args:
        config: plain containers: a training, a task as ``{"env": ...}``, or a battery as
            ``{"battery": {NAME: ...}}``.
        contents: by full key, a digest of what its value stands for, such as a file.

    Returns:
        Values as text. Configs with the same meaning have equal ones, in whatever order of keys,
        but for the order of the env's transforms, which has an entry.
    """
    tree = _tree(config)
    for key, content in contents.items():
        _put(tree, key.split("."), migrations.SAME_CONTENT.get(content, content))
    _rename(tree)
    for key, value in migrations.MISSING.items():
        for table, name in _places(tree, key):
            table.setdefault(name, _tree(value))
    for key in migrations.IRRELEVANT:
        for table, name in _places(tree, key):
            table.pop(name, None)
    _leave_out_defaults(tree)
    flat = _flat(tree)
    if transforms := (tree.get("env") or {}).get("transforms"):
        flat["order of env.transforms"] = " ".join(map(str, transforms))
    return flat


def differences(stored: Mapping[str, str], wanted: Mapping[str, str]) -> list[str]:
    """Where two meanings differ: ``optimizer.lr (0.001 stored, 0.0005 wanted)``."""
    keys = [key for key in {**wanted, **stored} if wanted.get(key) != stored.get(key)]
    pairs = ((key, stored.get(key, "nothing"), wanted.get(key, "nothing")) for key in keys)
    return [f"{key} ({old} stored, {new} wanted)" for key, old, new in pairs]


def _tree(value: Any) -> Any:
    """The same with tables and lists as dicts, and today's paths of classes and functions."""
    if isinstance(value, Mapping):
        return {str(key): _tree(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return dict(enumerate(map(_tree, value)))
    return moved(value) or value if isinstance(value, str) else value


def _put(tree: Tree, path: list[str], value: Any) -> None:
    """Sets a value at a place, whose tables are made if they are not there."""
    *tables, name = path
    for part in tables:
        in_list = part not in tree and part.isdecimal()
        tree = tree.setdefault(int(part) if in_list else part, {})
    tree[name] = value


def _tables(tree: Tree, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str, Tree]]:
    """Full key and content of every table and list, inner ones first."""
    for key, value in list(tree.items()):
        if isinstance(value, dict):
            yield from _tables(value, (*path, key))
    yield ".".join(map(str, path)), tree


def _places(tree: Tree, key: str) -> list[tuple[Tree, str]]:
    """Tables in which a key of ``migrations`` may stand, and its name there."""
    parent, _, name = key.rpartition(".")
    if not parent and "total_frames" not in tree:  # no training
        return []
    found = []
    for place, table in _tables(tree):
        fits = place.count(".") == parent.count(".") and fnmatchcase(place, parent)
        if fits or (parent and table.get("_target_") == parent):
            found.append((table, name))
    return found


def _rename(tree: Tree) -> None:
    for old, new in migrations.RENAMED.items():
        for table, name in _places(tree, old):
            if name not in table:
                continue
            if "." in new:
                _put(tree, new.split("."), table.pop(name))
                continue
            entries = {new if key == name else key: value for key, value in table.items()}
            table.clear()  # the order of transforms is kept
            table.update(entries)


def _leave_out_defaults(tree: Tree) -> None:
    """Drops arguments that are the default of what takes them, and empty entries of tables."""
    for _, table in _tables(tree):
        if "_target_" in table:
            defaults = _defaults(_imported(str(table["_target_"])))
            empty = [key for key in table if key in defaults and _flat(table[key]) == defaults[key]]
        else:
            empty = [
                key for key, value in table.items() if isinstance(key, str) and value in (None, {})
            ]
        for key in empty:
            del table[key]


def _imported(path: str) -> Any:
    """What a dotted path names, if its module is imported: what is stored imports nothing."""
    module, _, names = path, "", ""
    while module and module not in sys.modules:
        module, _, name = module.rpartition(".")
        names = f"{name}.{names}" if names else name
    found: Any = sys.modules.get(module)
    for name in names.split("."):
        found = getattr(found, name, None)
    return found


@cache
def _defaults(built: Any) -> Mapping[str | int, dict[str, str]]:
    """The defaults of the arguments of a class or function, in normal form."""
    if not callable(built):
        return {}
    try:
        made_by: Any = built.__init__ if inspect.isclass(built) else built
        signature = inspect.signature(made_by)
    except (TypeError, ValueError):  # compiled
        return {}
    given = {name: each.default for name, each in signature.parameters.items()}
    plain = {name: value for name, value in given.items() if isinstance(value, _PLAIN)}
    return {name: _flat(_tree(value)) for name, value in plain.items()}


def _flat(value: Any) -> dict[str, str]:
    """Values as text by their full keys."""
    return {".".join(map(str, path)): _text(each) for path, each in _leaves(value)}


def _leaves(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    if isinstance(value, dict) and value:
        for key, each in value.items():
            yield from _leaves(each, (*path, key))
    else:
        yield path, value


def _text(value: Any) -> str:
    """A number by its value, everything else as in JSON, which knows no infinity: ``.inf``."""
    return json.dumps(int(value) if _whole(value) else strict(value))


def _whole(value: Any) -> bool:
    return isinstance(value, float) and value.is_integer()


def strict(value: Any) -> Any:
    """Containers as JSON has them: an infinity and NaN become their names in yaml."""
    if isinstance(value, Mapping):
        return {str(key): strict(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [strict(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    return value
