"""What terms are given, and which functions are none."""

from functools import partial

import pytest

from zfall.envs.terms import bind


def whole(td, next_td, *, robot, scale=1.0):
    """What a term is called with."""
    return td, next_td, robot, scale


def test_a_term_is_given_what_it_asks_for_and_was_not_given():
    known = {"robot": "zeroth", "joint_range": "ranges"}
    assert bind(whole, **known)(1, 2) == (1, 2, "zeroth", 1.0)
    assert bind(partial(whole, robot="other", scale=3.0), **known)(1, 2) == (1, 2, "other", 3.0)


def test_a_term_within_a_term_is_given_it_too():
    def outer(td, next_td, *, term):
        return term(td, next_td)

    assert bind(partial(outer, term=whole), robot="zeroth")(1, 2) == (1, 2, "zeroth", 1.0)


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (lambda td, next_td, *, sigma: td, "must be given sigma, which has no default"),
        (lambda td, next_td, sigma: td, r"must take \(td, next_td\).* argument: 'sigma'\."),
        (lambda next_td: next_td, r"must take \(td, next_td\).*too many positional arguments\."),
    ],
)
def test_what_could_not_be_called_is_refused_when_it_is_named(term, message):
    with pytest.raises(ValueError, match=message):
        bind(term, robot="zeroth")
