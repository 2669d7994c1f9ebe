"""The search for movements that catch a fall."""

import pytest
import torch
from rich.console import Console

from zfall.falling import search as module
from zfall.falling.bank_worlds import BankWorlds
from zfall.falling.banks import bank_control_dt, load_bank, save_bank
from zfall.falling.files import own_file
from zfall.falling.making import SearchedCatches
from zfall.falling.making import catches as making
from zfall.falling.movements import HEADINGS, load_catches
from zfall.falling.recorded_falls import Falls, Landing
from zfall.falling.search import CrossEntropySearch, check_bins, first_guess, improve
from zfall.robots import ZEROTH01

BANK = own_file(ZEROTH01, "falls.npz")


@pytest.fixture
def score(make_base, monkeypatch):
    """In place of the physics a score that knows one best angle of one joint and posture [rad]."""
    env = make_base(num_envs=1)
    best = env.stand_position.repeat(3, 1)
    best[1, 2] = -0.9

    def known(falls, rows, moves, until):
        away = (moves - best)[:, 1, 2].abs()
        no, zero = torch.zeros(len(rows), dtype=torch.bool), torch.zeros(len(rows))
        return Landing(no, no, -away, zero, zero, zero)

    monkeypatch.setattr(module, "caught", known)
    return env


def test_the_search_finds_what_its_score_prefers(make_base):
    search = CrossEntropySearch(candidates=64, trials=2, elite=8, rounds=12, spread=0.4)
    env = make_base(num_envs=1)

    def known(rows, moves):
        assert len(rows) == len(moves) == 64 * 2
        assert (rows < 10).all()
        return -(moves[:, 1, 2] + 0.9).abs()

    found = search(known, torch.arange(10), env.stand_position.repeat(3, 1), env.joint_range)
    assert found[1, 2].item() == pytest.approx(-0.9, abs=0.03)
    low, high = env.joint_range.unbind(-1)
    assert ((found >= low) & (found <= high)).all()


def test_what_is_known_stays_where_nothing_better_is_found(score):
    """Of 0 degrees the best is known, of 30 degrees not; 60 degrees are left out."""
    falls = Falls(BankWorlds(8), BANK)
    search = CrossEntropySearch(candidates=16, trials=2, elite=4, rounds=6, spread=0.4)
    catches = first_guess(None, score.stand_position, [0.08, 0.16], [])
    catches.postures[0, 0, 1, 2] = -0.9
    before = catches.postures.clone()
    attempts = list(improve(catches, falls, search, HEADINGS[:2]))
    assert [attempt.heading for attempt in attempts] == [0, 30]
    assert all(attempt.falls >= 2 for attempt in attempts)
    assert [attempt.better for attempt in attempts] == [False, True]
    assert torch.equal(catches.postures[0], before[0])
    assert catches.postures[1, 0, 1, 2] < -0.6
    assert torch.equal(catches.postures[2:], before[2:])


def test_too_few_falls_are_not_searched(score):
    """No fall of the bank is as fast as 100 m/s."""
    falls = Falls(BankWorlds(8), BANK)
    catches = first_guess(None, score.stand_position, [0.08, 0.16], [100.0])
    search = CrossEntropySearch(candidates=4, trials=2, elite=2, rounds=1)
    slow, fast = improve(catches, falls, search, [180])
    assert slow.before is not None
    assert (fast.falls, fast.before, fast.better) == (0, None, False)


def test_a_search_with_other_bins_begins_with_the_nearest_of_the_robot(make_base):
    known, stand = load_catches(ZEROTH01), make_base(num_envs=1).stand_position
    more = first_guess(known, stand, [0.08, 0.16, 0.32, 0.6, 0.8], [1.65, 2.15, 2.4, 3.0])
    assert more.postures.shape == (12, 5, 6, 20)
    assert torch.equal(more.postures[:, :4, :5], known.postures)
    assert torch.equal(more.postures[:, 4], more.postures[:, 3])
    assert torch.equal(more.postures[:, :, 5], more.postures[:, :, 4])
    assert torch.equal(more.until[:5], torch.tensor([0.08, 0.16, 0.32, 0.6, 0.8]))
    assert more.until[5] == torch.inf


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"elite": 1}, "elite .* got 1"),
        ({"elite": 300}, "elite .* got 300"),
        ({"spread": float("inf")}, "spread .* got inf"),
        ({"rounds": 0}, "rounds .* got 0"),
    ],
)
def test_numbers_that_no_search_can_have_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        CrossEntropySearch(**values)


@pytest.mark.parametrize(
    ("headings", "speeds", "until", "message"),
    [
        ([45], [1.65], [0.08], r"headings .* got \[45\]"),
        ([], [1.65], [0.08], r"headings .* got \[\]"),
        ([0], [2.0, 1.0], [0.08], r"speeds .* got \[2.0, 1.0\]"),
        ([0], [1.0], [0.2, 0.1], r"until .* got \[0.2, 0.1\]"),
    ],
)
def test_bins_that_do_not_rise_or_have_no_movement_are_refused(headings, speeds, until, message):
    with pytest.raises(ValueError, match=message):
        check_bins(headings, speeds, until)


def test_a_fall_is_searched_at_the_rate_of_its_policy(tmp_path, monkeypatch):
    """A bank says how often its policy decides; those of before had 25 Hz."""
    states = {key: value[:2] for key, value in load_bank(BANK, ZEROTH01).items()}
    save_bank(tmp_path / "falls.npz", states, control_dt=0.02)
    assert (bank_control_dt(BANK), bank_control_dt(tmp_path / "falls.npz")) == (0.04, 0.02)
    rates, few = [], {"candidates": 2, "trials": 1, "elite": 2, "rounds": 1}

    def none(catches, falls, *args, **kwargs):
        rates.append(falls.env.control_dt)
        return iter(())

    monkeypatch.setattr(making, "improve", none)
    for bank in (BANK, tmp_path / "falls.npz"):
        SearchedCatches(falls=str(bank), **few).make(tmp_path / "catches.npz", Console(quiet=True))
    assert rates == [0.04, 0.02]
