"""Random numbers by a counter, against NumPy's own and against their distributions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare, kstest

from zfall.simulation.philox import fill_integers, fill_normal, fill_uniform, philox

WORD = st.integers(0, 2**64 - 1)
SEED, PURPOSE = np.uint64(5), np.uint64(2**63 + 9)


def words_of(key: list[int], counter: list[int], count: int) -> np.ndarray:
    """NumPy's words from a counter on: it adds one before it draws."""
    whole = sum(word << 64 * place for place, word in enumerate(counter)) - 1
    before = [(whole % 2**256) >> 64 * place & (2**64 - 1) for place in range(4)]
    return np.random.Philox(
        key=np.array(key, np.uint64), counter=np.array(before, np.uint64)
    ).random_raw(count)


def drawn(fill, width: int, num: int, *args, dtype=np.float32, first: int = 0) -> np.ndarray:
    out, at = np.zeros((num, width), dtype), np.full(num, first)
    fill(out, np.ones(num, bool), np.arange(num), at, SEED, PURPOSE, *args)
    return out


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(WORD, min_size=2, max_size=2), st.lists(WORD, min_size=4, max_size=4))
def test_words_are_those_of_numpy(key, counter):
    found = philox(*map(np.uint64, (*counter, *key)))
    assert [int(word) for word in found] == words_of(key, counter, 4).tolist()


def test_numbers_are_made_of_the_words_of_their_world():
    words = words_of([int(SEED), int(PURPOSE)], [7, 0, 2, 0], 8)
    halves = np.stack([words >> np.uint64(32), words & np.uint64(2**32 - 1)], -1).reshape(-1)
    uniform = drawn(fill_uniform, 13, 3, first=7)[2]
    assert (uniform == (halves[:13] >> np.uint64(8)) / 2**24).all()
    whole = drawn(fill_integers, 7, 3, np.uint64(10), dtype=np.int64, first=7)[2]
    assert whole.tolist() == [int(word) * 10 >> 64 for word in words[:7]]
    share, turn = halves[:14].astype(float).reshape(7, 2).T / 2**32
    radius, angle = np.sqrt(-2 * np.log(share)), 2 * np.pi * turn
    expected = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1).reshape(-1)
    assert drawn(fill_normal, 13, 3, first=7)[2] == pytest.approx(expected[:13], abs=2e-5)


@pytest.mark.parametrize(("fill", "per_word"), [(fill_uniform, 8), (fill_normal, 8)])
@pytest.mark.parametrize("width", [1, 8, 9, 60])
def test_no_number_is_drawn_twice_and_only_rows_move_on(fill, per_word, width):
    rows, at = np.array([True, False, True]), np.array([0, 5, 5])
    out = np.zeros((3, width), np.float32)
    fill(out, rows, np.arange(3), at, SEED, PURPOSE)
    blocks = -(-width // per_word)
    assert at.tolist() == [blocks, 5, 5 + blocks]
    assert (out[1] == 0).all()
    again = np.zeros((3, width), np.float32)
    fill(again, rows, np.arange(3), at, SEED, PURPOSE)
    assert not set(out[rows].flatten()) & set(again[rows].flatten())


def test_uniform_numbers_are_uniform_in_the_unit_interval():
    values = drawn(fill_uniform, 400, 500)
    assert values.min() >= 0.0
    assert values.max() < 1.0
    assert kstest(values.flatten(), "uniform").pvalue > 0.01


def test_normal_numbers_have_the_quantiles_and_moments_of_a_normal_distribution():
    values = drawn(fill_normal, 400, 500).astype(float)
    count = values.size
    assert kstest(values.flatten(), "norm").pvalue > 0.01
    # Standard errors of the first four moments of N(0, 1): 1, 2, 15 and 96 over n.
    for order, (moment, variance) in enumerate([(0, 1), (1, 2), (0, 15), (3, 96)], start=1):
        assert abs((values**order).mean() - moment) < 4 * np.sqrt(variance / count)
    assert (np.abs(values) > 4).mean() == pytest.approx(6.33e-5, abs=8e-5)


@pytest.mark.parametrize("high", [1, 3, 37])
def test_whole_numbers_are_equally_likely(high):
    values = drawn(fill_integers, 100, 500, np.uint64(high), dtype=np.int64)
    counts = np.bincount(values.flatten(), minlength=high)
    assert len(counts) == high
    assert high == 1 or chisquare(counts).pvalue > 0.01


def test_worlds_purposes_seeds_and_steps_are_independent():
    """Correlations of 200 000 pairs: of N(0, 1 / n) if there is none."""
    base = drawn(fill_normal, 400, 500)
    others = {"world": np.roll(base, 1, 0), "number": np.roll(base, 1, 1)}
    for name, seed, purpose in (("seed", SEED + np.uint64(1), PURPOSE), ("purpose", SEED, SEED)):
        out = np.zeros_like(base)
        fill_normal(out, np.ones(500, bool), np.arange(500), np.zeros(500, int), seed, purpose)
        others[name] = out
    others["step"] = drawn(fill_normal, 400, 500, first=50)
    for name, other in others.items():
        for one, two in ((base, other), (base**2 - 1, other**2 - 1)):
            r = np.corrcoef(one.flatten(), two.flatten())[0, 1]
            assert abs(r) < 4 / np.sqrt(base.size), name
