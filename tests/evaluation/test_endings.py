"""What a film says came of its worlds."""

import math
from types import SimpleNamespace
from typing import ClassVar

import torch
from tensordict import TensorDict

from zfall.evaluation import endings
from zfall.evaluation.endings import Endings, said


class Rests:
    """A follower by whose outcome a world rests while a key says so."""

    outcomes: ClassVar = ("rested",)

    def __init__(self, env):
        self.now = torch.zeros(env.num_envs, dtype=torch.bool)

    def update(self, td, now):
        self.now = td["rests"]

    def table(self, ended):
        return {"rested": self.now & ended.fell, "other": self.now}


def followed(monkeypatch, rows, followers=(Rests,)):
    """Steps of 0.1 s; each row has for every world: touches, rests, the task ends."""
    monkeypatch.setattr(endings, "body_contact", lambda td, _: td["down"][:, None])
    out = Endings(SimpleNamespace(num_envs=len(rows[0])), followers)
    for number, row in enumerate(rows, 1):
        down, rests, ends = (
            torch.tensor(column, dtype=torch.bool) for column in zip(*row, strict=True)
        )
        td = TensorDict({"down": down, "rests": rests, "terminated": ends[:, None]}, [len(row)])
        td["diverged"] = torch.zeros(len(row), 1, dtype=torch.bool)
        out.update(td, 0.1 * number)
    return out


STANDS, DOWN, RESTS, ENDS = (0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 0, 1)


def test_who_goes_down_as_meant_is_not_said_to_fall(monkeypatch):
    """World 0 rests from 0.3 s on; world 1 gives that up at 0.4 s; world 2 just falls."""
    rows = [[STANDS] * 5, [DOWN, RESTS, DOWN, STANDS, ENDS], [RESTS, RESTS, DOWN, STANDS, STANDS],
            [RESTS, DOWN, DOWN, STANDS, STANDS]]  # fmt: skip
    out = followed(monkeypatch, rows)
    assert [words for _, words, _ in out.said(0, 0.4)] == ["rested {when}"]
    assert [words for _, words, _ in out.said(1, 0.4)] == [
        "rested {when}", "fell {when}"
    ]  # fmt: skip
    assert [good for _, _, good in out.said(1, 0.4)] == [True, False]
    assert [words for _, words, _ in out.said(2, 0.4)] == ["fell {when}"]
    assert [words for _, words, _ in out.said(3, 0.4)] == ["stays up"]
    assert [words for _, words, _ in out.said(4, 0.4)] == ["task ended {when}"]
    assert [words for _, words, _ in out.said(4, 0.4, task=False)] == ["stays up"]
    assert out.reached["rested"].tolist() == [True, False, False, False, False]
    assert out.fell.tolist() == [True, True, True, False, False]
    assert out.up.tolist() == [False, False, False, True, False]


def test_without_followers_whoever_touches_the_floor_fell(monkeypatch):
    out = followed(monkeypatch, [[DOWN], [RESTS], [RESTS]], followers=())
    assert [words for _, words, _ in out.said(0, 0.3)] == ["fell {when}"]


def test_a_film_says_stays_up_only_of_who_does():
    assert said(math.nan, 10.0) == [(8.5, "stays up", True)]
    assert said(3.2, 10.0) == [(3.2, "fell {when}", False)]
    assert said(5.0, 10.0, ended=3.0) == [(3.0, "task ended {when}", False)]
