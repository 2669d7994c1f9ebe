"""Advantages among worlds that began alike; those of a recurrent critic are in test_learner."""

import pytest
import torch
from torch.testing import assert_close

from zfall.losses.advantage import advantage_among_alike


def test_each_is_compared_with_the_mean_of_the_others():
    """By hand, two groups of three: 1 - (3 + 5) / 2, 3 - (1 + 5) / 2, and so on; by time step."""
    first = torch.tensor([1.0, 3.0, 5.0, 10.0, 10.0, 40.0])
    advantage = torch.stack([first, torch.zeros(6)], 1)[..., None]
    expected = torch.tensor([-3.0, 0.0, 3.0, -15.0, -15.0, 30.0])
    out = advantage_among_alike(advantage, 3)
    assert_close(out[:, 0, 0], expected)
    assert_close(out[:, 1, 0], torch.zeros(6))


def test_the_gradient_is_that_without_a_baseline_but_with_less_noise():
    """A bandit: state s from N(0, 10), action a from N(0, 1), return 3 a + s; E[return * a] = 3.

    Without a baseline the deviation of return * a is about 11, with it that of
    (3 a - 3 mean of the others) * a, by hand sqrt(9 * 2 + 9 / 3) = 4.6 for four alike.
    """
    torch.manual_seed(0)
    state, action = 10.0 * torch.randn(50_000, 1).expand(-1, 4), torch.randn(50_000, 4)
    returns = (3.0 * action + state).reshape(-1, 1, 1)
    scores = advantage_among_alike(returns, 4).reshape(-1) * action.reshape(-1)
    assert scores.mean().item() == pytest.approx(3.0, abs=5 * 4.6 / 200_000**0.5)
    assert scores.std().item() == pytest.approx(21**0.5, abs=0.1)
