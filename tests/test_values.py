"""Kinds of values and their rules, each at the edge of what it takes."""

import math
from typing import Annotated

import pytest

from zfall import values
from zfall.complaints import complaint
from zfall.values import NamesOf, Rule, check_names, one_of, shown

EDGES = {  # what is taken, and what is not
    "Number": ([-1.0, 0, math.inf, -math.inf], [math.nan, True, "1", None]),
    "Positive": ([1, 1e-300], [0, 0.0, -1, math.inf, math.nan, True, "1", [1]]),
    "PositiveOrInfinite": ([1e-300, math.inf], [0, -math.inf, math.nan]),
    "NotNegative": ([0, 0.0, 2], [-1e-300, math.inf, math.nan, False]),
    "NotNegativeOrInfinite": ([0, math.inf], [-1e-300, -math.inf, math.nan]),
    "Fraction": ([0, 1, 0.5], [-1e-9, 1.0000001, math.nan, True]),
    "FractionBelowOne": ([0, 0.999], [1, 1.0, -1e-9]),
    "OpenFraction": ([1e-9, 0.999], [0, 1]),
    "FractionAboveZero": ([1e-9, 1], [0, 1.0000001]),
    "Count": ([1, 10**9], [0, -1, 1.0, True, "1"]),
    "Whole": ([0, 1], [-1, 0.0, False]),
    "Seed": ([0, 2**63 - 1], [-1, 2**63, 0.0]),
    "Name": (["a", " a "], ["", " ", "\n", 1, None]),
    "Bounds": ([[1, 1], [-2.0, 3]], [[2, 1], [1], [1, 2, 3], 1, [0, math.nan], [0, math.inf], [True, 2]]),
    "PositiveBounds": ([[1, 1]], [[0, 1], [2, 1]]),
    "NotNegativeBounds": ([[0, 0]], [[-1, 1], [1, 0]]),
    "Times": ([[0, 0.1], [1, 1]], [[0, 0], [0.2, 0.1], [-1, 1], 1]),
    "Keys": ([["a"], ["a", ["b", "c"]]], [[], "a"]),
    "Names": ([["a"]], [[], [""], "a"]),
    "Node": ([{"_target_": "a.B"}], [{}, {"a": 1}, 3, "a.B", {"_target_": "a.B", "_partial_": True}]),
}  # fmt: skip


@pytest.mark.parametrize("name", EDGES)
def test_a_rule_holds_up_to_its_edge_and_not_beyond(name):
    kind = getattr(values, name)
    good, bad = EDGES[name]
    for value in good:
        assert complaint(value, kind, "a.b") is None, value
    for value in bad:
        text = complaint(value, kind, "a.b")
        assert text is not None, value
        assert text.startswith("a.b"), text
        assert "\n" not in text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "null"), (True, "true"), (False, "false"), ("", "''"), ("a\n  b", "a b"),
        (1, "1"), ("True", "True"), ("x" * 120, "x" * 120), ("x" * 121, "x" * 117 + "..."),
    ],
)  # fmt: skip
def test_a_value_is_shown_as_the_yaml_has_it(value, text):
    assert shown(value) == text


def test_one_of_a_few_names():
    rule = one_of("last", "best")
    assert rule.text == "be last or best"
    assert rule.holds("best")
    assert not rule.holds("Best")


REGIONS = NamesOf("a region", lambda robot: robot)


def touched(
    region: Annotated[str, REGIONS], others: Annotated[list[str], REGIONS, Rule("", bool)], n: int
) -> None:
    """Takes names of regions."""


def test_names_that_are_not_there_are_refused_with_the_nearest():
    robot = ["torso", "left_hand"]
    check_names(touched, {"region": "torso", "others": ["left_hand", "torso"], "n": 3}, robot)
    check_names(touched, {}, robot)
    with pytest.raises(
        ValueError,
        match=r"^others must be a region \(torso, left_hand\), got left_hnd; did you mean left_hand",
    ):
        check_names(touched, {"others": ["torso", "left_hnd"]}, robot)
    with pytest.raises(ValueError, match=r"^region must be .*, got 7\.$"):
        REGIONS.check("region", [7], robot)
