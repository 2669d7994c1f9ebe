"""Norms of gradients, and the bounds on them."""

import math

import pytest
import torch
from torch import nn

from zfall.training.gradients import clip_gradients, parts_of


def parts(actor: list[float], critic: list[float]) -> dict[str, list[nn.Parameter]]:
    """A parameter for each, with that gradient."""
    made = {}
    for name, gradient in {"actor": actor, "critic": critic}.items():
        parameter = nn.Parameter(torch.zeros(len(gradient)))
        parameter.grad = torch.tensor(gradient)
        made[name] = [parameter]
    return made


def test_one_bound_is_on_the_norm_of_all():
    """Norms 5 and 12 are 13 together: the actor's 5 becomes 5 / 13."""
    both = parts([3.0, 4.0], [0.0, 12.0])
    norms = clip_gradients(both, 1.0)
    assert norms["gradient/actor"] == 5
    assert norms["gradient/critic"] == 12
    assert both["actor"][0].grad.norm().item() == pytest.approx(5 / 13, rel=1e-5)
    assert both["critic"][0].grad.norm().item() == pytest.approx(12 / 13, rel=1e-5)


def test_a_bound_for_each_leaves_the_actor_its_step_beside_a_large_critic():
    both = parts([3.0, 4.0], [0.0, 12.0])
    norms = clip_gradients(both, {"actor": 10.0, "critic": 2.0})
    assert norms["gradient/actor"] == 5
    assert norms["gradient/critic"] == 12
    assert both["actor"][0].grad.tolist() == [3.0, 4.0]
    assert both["critic"][0].grad.norm().item() == pytest.approx(2, rel=1e-5)


def test_no_bound_cuts_nothing():
    both = parts([3.0, 4.0], [0.0, 12.0])
    clip_gradients(both, math.inf)
    assert both["actor"][0].grad.tolist() == [3.0, 4.0]


def test_a_trunk_of_both_is_the_actors_and_is_there_once():
    trunk = nn.Linear(2, 2)
    actor, critic = nn.Sequential(trunk, nn.Linear(2, 1)), nn.Sequential(trunk, nn.Linear(2, 3))
    found = parts_of(actor, critic)
    assert [len(part) for part in found.values()] == [4, 2]
    assert all(p not in set(found["actor"]) for p in found["critic"])
