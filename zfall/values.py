"""Kinds of values that a yaml may give, said by the annotation of the parameter that takes them.

A number is finite unless ``INFINITE`` is among its extras, and never NaN. A ``Rule`` narrows it, so
that range and value stand in one place, ``std: Positive``; ``NamesOf`` is one that needs an object.
``zfall.static_checks`` holds a config against them before anything is built.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Annotated, Any, get_args, get_origin, get_type_hints


def shown(value: Any) -> str:
    """A value as the yaml has it, cut where it is long."""
    text = "null" if value is None else repr(value) if value == "" else " ".join(str(value).split())
    text = {"True": "true", "False": "false"}.get(text, text) if isinstance(value, bool) else text
    return text if len(text) <= 120 else f"{text[:117]}..."


@dataclass(frozen=True)
class Rule:
    """What holds for a value: ``Annotated[float, Rule("be positive", lambda x: x > 0)]``.

    Args:
        text: goes on from "must".
        holds: whether a value of the right kind keeps to it.
    """

    text: str
    holds: Callable[[Any], bool]


def one_of(*names: str) -> Rule:
    """That a text is one of a few."""
    return Rule(f"be {' or '.join(names)}", lambda x: x in names)


@dataclass(frozen=True)
class NamesOf:
    """What holds for names that depend on an object which is there later: regions of a robot.

    Args:
        what: they are, in words.
        known: all that there are.
    """

    what: str
    known: Callable[[Any], Collection[str]]

    def check(self, key: str, names: str | Sequence[str], of: Any) -> None:
        """Refuses names that are not there.

        Raises:
            ValueError: with the nearest.
        """
        known = list(self.known(of))
        for name in [names] if isinstance(names, str) else names:
            if name not in known:
                near = get_close_matches(str(name), known, n=1)
                hint = f"; did you mean {near[0]}?" if near else "."
                there = ", ".join(known)
                raise ValueError(f"{key} must be {self.what} ({there}), got {shown(name)}{hint}")


def check_names(function: Any, values: Mapping[str, Any], of: Any) -> None:
    """Refuses values of a function's parameters that name what is not there, see ``NamesOf``.

    Raises:
        ValueError: naming the parameter.
    """
    for key, kind in get_type_hints(function, include_extras=True).items():
        for extra in get_args(kind)[1:] if get_origin(kind) is Annotated else ():
            if isinstance(extra, NamesOf) and key in values:
                extra.check(key, values[key], of)


INFINITE = "a number that may be infinite"  # an extra: Annotated[float, INFINITE]

Number = Annotated[float, INFINITE]
Positive = Annotated[float, Rule("be positive and finite", lambda x: x > 0)]
PositiveOrInfinite = Annotated[float, INFINITE, Rule("be positive", lambda x: x > 0)]
NotNegative = Annotated[float, Rule("be finite and not negative", lambda x: x >= 0)]
NotNegativeOrInfinite = Annotated[float, INFINITE, Rule("not be negative", lambda x: x >= 0)]
Fraction = Annotated[float, Rule("lie in [0, 1]", lambda x: 0 <= x <= 1)]
FractionBelowOne = Annotated[float, Rule("lie in [0, 1)", lambda x: 0 <= x < 1)]
OpenFraction = Annotated[float, Rule("lie in (0, 1)", lambda x: 0 < x < 1)]
FractionAboveZero = Annotated[float, Rule("lie in (0, 1]", lambda x: 0 < x <= 1)]
Count = Annotated[int, Rule("be at least 1", lambda x: x >= 1)]
Whole = Annotated[int, Rule("be at least 0", lambda x: x >= 0)]
# Of a random generator: torch takes 64 bits, NumPy no negative ones.
Seed = Annotated[int, Rule("be at least 0 and below 2^63", lambda x: 0 <= x < 2**63)]
Name = Annotated[str, Rule("not be empty", lambda x: bool(x.strip()))]
ORDERED = Rule("be two numbers, the smaller first", lambda x: len(x) == 2 and x[0] <= x[1])
Bounds = Annotated[Sequence[float], ORDERED]
PositiveBounds = Annotated[Sequence[Positive], ORDERED]
NotNegativeBounds = Annotated[Sequence[NotNegative], ORDERED]
# Of times that are drawn: [0, 0] would be no time at all.
Times = Annotated[
    Sequence[NotNegative],
    ORDERED,
    Rule("be two times of which the longer is positive", lambda x: x[1] > 0),
]
Key = str | Sequence[str]  # of a TensorDict, nested or not
Keys = Annotated[Sequence[Key], Rule("name at least one quantity", lambda x: len(x) > 0)]
Names = Annotated[Sequence[Name], Rule("hold at least one name", lambda x: len(x) > 0)]
Node = Annotated[
    Mapping[str, Any],
    Rule("be a table with a _target_, the dotted path of a class", lambda x: "_target_" in x),
    Rule("be built at once, without _partial_", lambda x: not x.get("_partial_")),
]
