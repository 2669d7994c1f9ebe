"""The search for postures that catch a fall."""

import math

import pytest
import torch

from recipes import catches
from zfall.envs.robots import ZEROTH01


@pytest.fixture
def small(monkeypatch):
    for name, value in {"WORLDS": 8, "ELITE": 2, "ROUNDS": 2, "HEADINGS": (180,)}.items():
        monkeypatch.setattr(catches, name, value)


def test_a_seat_catches_who_is_pushed_back_and_standing_does_not(small, make_base):
    """I = 0.6, nearly twice what the pendulum without a step withstands backward."""
    env = make_base(num_envs=8, control_dt=0.04)
    seat = torch.tensor([ZEROTH01.catches[180].get(joint, 0.0) for joint in ZEROTH01.joints])
    postures = torch.where(torch.arange(8)[:, None] < 4, seat, env.stand_position)
    safe, kneels, lasted = catches.caught(env, postures, 0.6, math.pi)
    assert safe.tolist() == kneels.tolist() == [True] * 4 + [False] * 4
    assert (lasted[:4] - 1.0).abs().max() < 1e-5
    assert lasted[4:].max() < 0.9


def test_half_of_the_draws_are_their_own_mirror_image(small, make_base):
    env = make_base(num_envs=8)
    drawn = catches.draw(env, torch.Generator().manual_seed(0))
    own = [list(pose) == pytest.approx(ZEROTH01.mirrored(pose)) for pose in drawn.tolist()]
    assert own == [True] * 4 + [False] * 4


def test_the_search_prints_a_pose_for_each_heading(small, capsys, monkeypatch):
    monkeypatch.setattr(catches, "PUSHES", ((0.6, 0.0),))
    catches.main()
    out = capsys.readouterr().out
    assert "180, round 1: " in out
    assert "180: {'right_hip_yaw'" in out
