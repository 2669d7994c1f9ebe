"""What a ball leaves with the robot, by hand."""

from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from tests.evaluation.moments import ended, moment
from zfall.evaluation.ball_hits import BallHits
from zfall.robots import Ball

ENV = SimpleNamespace(
    num_envs=3, ball=Ball(mass=0.5, radius=0.04), robot=SimpleNamespace(impulse_unit=5.0)
)


def flying(*speeds: tuple[float, float]) -> TensorDict:
    """Balls with these level velocities, which fall."""
    velocity = torch.tensor([[x, y, -1.0] for x, y in speeds])
    return TensorDict({("ball", "velocity"): velocity}, [3])


def test_the_change_of_momentum_counts_while_the_ball_is_near():
    """0.5 kg from 4 m/s: stopped 2 N s, bounced to -1 m/s 2.5 N s, missed 0, in units of 5 N s.
    What happens 0.7 s after the launch, on the floor, does not count."""
    hits = BallHits(ENV)
    all_run = [True, True, True]
    hits.update(flying((4, 0), (0, 4), (4, 0)), moment(all_run, 0.04))
    hits.update(flying((0, 0), (0, -1), (4, 0)), moment(all_run, 0.28))
    hits.update(flying((-4, 0), (0, 0), (0, 0)), moment(all_run, 0.7))
    found = hits.table(ended([False] * 3))["ball_impulse"]
    assert found.tolist() == pytest.approx([0.4, 0.5, 0.0])
    over = hits.table(ended([True] * 3, [False, False, True]))["ball_impulse"]
    assert over.isnan().tolist() == [False, False, True]


def test_without_a_ball_there_is_nothing_to_follow():
    with pytest.raises(ValueError, match="measures must name BallHits only where base_env has"):
        BallHits(SimpleNamespace(num_envs=1, ball=None))
