"""What is said of a value that is of another kind than its annotation."""

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import pytest

from zfall.complaints import check_table, complaint, is_node, joined, unknown_key
from zfall.values import Count, Positive, Rule


class Inner(TypedDict):
    """A table in a table."""

    sizes: Sequence[Count]


class Keys(TypedDict):
    """A table as a recipe has it."""

    seed: int
    mode: Literal["mean", "mode", 1]
    inner: Inner
    more: NotRequired[Mapping[str, Positive] | None]


GOOD = {"seed": 0, "mode": "mean", "inner": {"sizes": [1, 2]}}
NODE = {"_target_": "mine.Class"}


@pytest.mark.parametrize("more", [{}, {"more": None}, {"more": {"a": 0.5}}, {"mode": 1}])
def test_a_table_that_fits_is_taken(more):
    check_table(GOOD | more, Keys)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"seed": "x"}, "run.seed must be a whole number, got x."),
        ({"seed": True}, "run.seed must be a whole number, got true."),
        ({"seed": "???"}, "run.seed must be given, it has no default; got ???."),
        ({"mode": True}, "run.mode must be mean or mode or 1, got true."),
        ({"mode": "median"}, "run.mode must be mean or mode or 1, got median."),
        ({"inner": 3}, "run.inner must be a table of sizes, got 3."),
        ({"inner": {"sizes": 3}}, "run.inner.sizes must be a list, [3], got 3."),
        ({"inner": {"sizes": None}}, "run.inner.sizes must be a list, got null."),
        ({"inner": {"sizes": [1, 0]}}, "run.inner.sizes.1 must be at least 1, got 0."),
        ({"inner": {}}, "run.inner.sizes must be given, a list; it is not there."),
        ({"more": 3}, "run.more must be a table or null, got 3."),
        ({"more": {"a": -1}}, "run.more.a must be positive and finite, got -1."),
        ({"more": {"a": 10**400}}, "run.more.a must be a number of at most 1e308, got one larger."),
        ({"sead": 1}, "run.sead is not a key of the config (seed, mode, inner, more); "
                      "did you mean seed?"),
    ],
)  # fmt: skip
def test_the_key_the_rule_and_the_value_are_named(change, text):
    with pytest.raises(ValueError, match=r"^run\.") as caught:
        check_table(GOOD | change, Keys, "run")
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("value", "kind", "text"),
    [
        ([1, 2], tuple[int, int, int], "a must be a list of 3, got [1, 2]."),
        ([1, "x"], tuple[int, ...], "a.1 must be a whole number, got x."),
        ({"b": 1}, list[int], "a must be a list, got {'b': 1}."),
        (0, int | Literal["all"], None),
        ("al", int | Literal["all"], "a must be a whole number or all, got al."),
        (-1, Positive | None, "a must be positive and finite, got -1."),
        ({1: 2}, Mapping[str, int], "the key 1 of a must be text, got 1."),
        (3, Callable[[], Any], "a must be a table with a _target_ and _partial_: true, got 3."),
        (NODE | {"_partial_": True}, Callable[[], Any], None),
        (NODE | {"_partial_": True}, Sequence[int], "a must be built at once: take its _partial_ out."),
        (NODE, Sequence[int], None),
        (NODE, tuple[float, float], None),
        ({"_target_": "f", "_partial_": True}, tuple[float | None, Callable[[], Any]],
         "a must be a list, [a number or null, a table with a _target_ and _partial_: true], got "
         "{'_target_': 'f', '_partial_': True}."),
        (3, Any, None),
        (4, Annotated[int, Rule("be odd", lambda x: x % 2), Rule("be small", lambda x: x < 9)],
         "a must be odd, got 4."),
    ],
)  # fmt: skip
def test_a_value_is_compared_with_any_annotation(value, kind, text):
    assert complaint(value, kind, "a") == text


def test_the_nearest_key_is_offered_if_there_is_one():
    assert unknown_key("env", "sed", ["seed"]).endswith(
        "env.sed is not a key of the config (seed); did you mean seed?"
    )
    assert unknown_key("", "x", [], "mine").endswith("x is not a parameter of mine (it has none).")
    assert (joined("", "a"), joined("a", 0)) == ("a", "a.0")
    assert is_node(NODE)
    assert not is_node({"target": 1})
