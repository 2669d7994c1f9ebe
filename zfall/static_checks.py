"""A config checked against what its targets take, before anything is built.

Every table with a ``_target_`` names a class or function of which Python knows the parameters and
what kinds of values they take (``zfall.values``). So the rule of a value stands where it is used,
and a user's own class is checked as ours are.
"""

import inspect
import math
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Unpack, get_args, get_origin, get_type_hints

from zfall.complaints import complaint, joined, unknown_key
from zfall.configs import nodes_of
from zfall.errors import object_at
from zfall.kinds import described, is_live, is_ours
from zfall.values import Name, shown

HYDRA_KEYS = {
    "_target_": Name,
    "_partial_": bool,
    "_recursive_": bool,
    "_convert_": str,
    "_args_": list[Any],
}
TABLE_KEYS = {"before"}  # which any transform of a table may have, see ``make_env``
_CONVERSIONS = ("none", "partial", "object", "all")
_NAMED = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


def check_nodes(config: Any, place: str = "") -> None:
    """Refuses a config whose tables do not fit what they are to build.

    Args:
        config: plain containers, as ``OmegaConf.to_container(cfg, resolve=True)`` gives.
        place: full key of ``config`` itself.

    Raises:
        ValueError: on NaN anywhere; a ``_target_`` that is not there; a key that is no parameter,
            naming the nearest; a value of another kind than its parameter takes, or against its
            rule; or a parameter that has no value.
    """
    check_numbers(config, place)
    for key, node in nodes_of(config, place):
        check_node(node, key)


def check_numbers(config: Any, place: str = "") -> None:
    """Refuses NaN wherever it stands, even where any value will do.

    Args:
        config: plain containers.
        place: full key of ``config`` itself.

    Raises:
        ValueError: naming the key.
    """
    for key, value in _values_of(config, place):
        if isinstance(value, float) and math.isnan(value):
            raise ValueError(f"{key} must be a number, got nan.")


def check_node(node: Mapping[str, Any], place: str) -> None:
    """As ``check_nodes``, for one table.

    Raises:
        ValueError: as there.
    """
    target = node["_target_"]
    if not isinstance(target, str) or not target.strip():
        raise ValueError(f"{joined(place, '_target_')} must be a dotted path, got {shown(target)}.")
    called = object_at(target, joined(place, "_target_"))
    if not callable(called):
        raise ValueError(
            f"{joined(place, '_target_')} must name a class or a function, got {target}."
        )
    parameters = parameters_of(called)
    named = {name for name in parameters if name != "**"}
    names = named | HYDRA_KEYS.keys()
    if place.rpartition(".")[0].split(".")[-1] == "transforms":
        names |= TABLE_KEYS
    for key, value in node.items():
        key = str(key)
        if key not in names and ("**" not in parameters or key.startswith("_")):
            known = HYDRA_KEYS if key.startswith("_") else sorted(named)
            text = unknown_key(place, key, known, target.rpartition(".")[2])
            raise ValueError(f"{text} '~{joined(place, key)}' takes it out.")
        kind = HYDRA_KEYS[key] if key in HYDRA_KEYS else parameters.get(key, (Any, True))[0]
        if wrong := complaint(value, kind, joined(place, key)):
            raise ValueError(wrong)
    if (conversion := node.get("_convert_", "none")) not in _CONVERSIONS:
        raise ValueError(
            f"{joined(place, '_convert_')} must be one of {', '.join(_CONVERSIONS)}, "
            f"got {shown(conversion)}."
        )
    for name, (kind, optional) in parameters.items():
        if not optional and name not in node:
            raise ValueError(
                f"{joined(place, name)} must be given, {described(kind)}; "
                f"{target.rpartition('.')[2]} has no default for it."
            )


@cache
def parameters_of(called: Any) -> dict[str, tuple[Any, bool]]:
    """Kind of each parameter that a config may give, by name, and whether it may be left out.

    What only a live object can be comes from whoever builds it: by keyword it may be left out, and
    positional it is none of the config's where the function is ours. ``**`` among the names says
    that any other is taken, too. A class that passes ``**values`` on takes the parameters of the
    class that it is made from; with ``for_task``, those of both. ``**values: Unpack[Table]`` has
    the keys of that ``TypedDict``.
    """
    found: dict[str, tuple[Any, bool]] = {}
    for function in _called(called):
        hints = _hints(function)
        open_ended = False
        for parameter in _parameters(function):
            kind = hints.get(parameter.name, Any)
            if parameter.kind is parameter.VAR_KEYWORD:
                if get_origin(kind) is Unpack:
                    table = get_args(kind)[0]
                    for name, entry in get_type_hints(table, include_extras=True).items():
                        found.setdefault(name, (entry, name not in table.__required_keys__))
                else:
                    open_ended = True
            elif parameter.kind in _NAMED and not _is_passed(function, parameter, kind):
                optional = (
                    parameter.default is not parameter.empty
                    or parameter.kind is parameter.POSITIONAL_OR_KEYWORD
                    or is_live(kind)
                )
                found.setdefault(parameter.name, (kind, optional))
        if not open_ended:
            return found
    return found | {"**": (Any, True)}


def _called(called: Any) -> Iterator[Any]:
    """The functions that take the values of a table, the outermost first."""
    if not isinstance(called, type):
        yield called
        return
    if hasattr(called, "for_task"):
        yield called.for_task
    for base in called.__mro__:
        if "__init__" in vars(base) and base is not object:
            yield vars(base)["__init__"]


def _parameters(function: Any) -> list[inspect.Parameter]:
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):  # written in C
        return [inspect.Parameter("values", inspect.Parameter.VAR_KEYWORD)]
    if parameters and parameters[0].name == "self":
        return parameters[1:]
    return parameters


def _hints(function: Any) -> dict[str, Any]:
    try:
        return get_type_hints(function, include_extras=True)
    except Exception:  # names that only a type checker knows
        return {}


def _is_passed(function: Any, parameter: inspect.Parameter, kind: Any) -> bool:
    """Whether it is an env, a network, a spec that we pass to a function of ours."""
    positional = parameter.kind is parameter.POSITIONAL_OR_KEYWORD
    required = positional and parameter.default is parameter.empty
    return required and is_ours(function) and is_live(kind)


def _values_of(config: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Full key and value of all that is no container."""
    if isinstance(config, Mapping):
        for key, value in config.items():
            yield from _values_of(value, joined(place, key))
    elif isinstance(config, list | tuple):
        for number, value in enumerate(config):
            yield from _values_of(value, joined(place, number))
    else:
        yield place, config
