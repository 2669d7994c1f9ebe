"""What a trigger learns from pushed trials."""

import math

import pytest
import torch

from zfall.falling.fall_network import FallNetwork
from zfall.falling.trigger import History, calibrate, fit, probabilities


def made_up(trials: int = 400) -> History:
    """Falls with the chance that a measured number says, from the push at step 5 on."""
    torch.manual_seed(1)
    chance = torch.rand(trials)
    measured = chance[:, None, None].expand(-1, 12, 6).clone()
    measured[:, :5] = 0.0
    fell = torch.rand(trials) < chance
    live = torch.ones(trials, 12, dtype=torch.bool)
    live[fell, 10:] = False
    pushed = (torch.arange(12) >= 5).expand(trials, -1)
    return History(measured, chance[:, None], chance[:, None], live, fell, pushed)


def test_calibration_makes_what_is_said_come_true():
    """The raw logit is three times too sure of itself and shifted; Platt's fit takes both back."""
    history = made_up(4000)
    history = history._replace(live=torch.ones_like(history.live))  # all steps count alike

    class Sure(FallNetwork):
        def logits(self, sequence, memory=None):
            p = sequence[..., 0].clamp(0.01, 0.99)
            known = 3.0 * torch.logit(p) + 1.0
            return torch.where(sequence[..., 0] == 0, -60.0, known), torch.zeros(len(sequence), 1)

    network = Sure(6, 4)
    calibrate(network, history)
    said = probabilities(network, history)[:, 5]
    for low in (0.1, 0.3, 0.5, 0.7):
        rows = (said > low) & (said < low + 0.2)
        assert rows.sum() > 100
        assert history.fell[rows].float().mean() == pytest.approx(
            said[rows].mean().item(), abs=0.07
        )


def test_calibration_of_what_can_be_told_apart_stays_finite():
    """Two logits, one for each outcome: Platt's targets, 31 of 32 and 1 of 72, are met by both."""
    fell = torch.arange(100) < 30
    live = torch.ones(100, 1, dtype=torch.bool)
    measured = torch.where(fell, 2.0, -1.0)[:, None, None]
    zero = torch.zeros(100, 1)
    history = History(measured, zero, zero, live, fell, torch.ones_like(live))

    class Certain(FallNetwork):
        def logits(self, sequence, memory=None):
            return sequence[..., 0], torch.zeros(len(sequence), 1)

    network = Certain(1, 4)
    calibrate(network, history)
    high, low = math.log(31 / 1), math.log(1 / 71)  # logit of 31/32 and of 1/72
    assert network.slope.item() == pytest.approx((high - low) / 3, rel=1e-3)
    assert network.offset.item() == pytest.approx(high - 2 * (high - low) / 3, rel=1e-2)


def test_a_network_learns_the_chance_of_a_fall():
    """From made-up trials in which one number says the chance: 20 % or 80 % for half of them."""
    history = made_up(600)
    chance = torch.where(history.lean[:, 0] < 0.5, 0.2, 0.8)
    fell = torch.rand(600) < chance
    seen = chance[:, None, None].expand(-1, 12, 6).clone()
    seen[:, :5] = 0.0
    live = torch.ones_like(history.live)
    history = history._replace(measured=seen, fell=fell, live=live)
    losses = []
    network = fit(
        history, ["a"], 0.04, hidden_size=4, epochs=60, progress=lambda n, x: losses.append(x)
    )
    assert network.trained_with == {"keys": ["a"], "control_dt": 0.04}
    assert len(losses) == 60
    assert losses[-1] < losses[0]
    said = probabilities(network, history)
    assert said[:, 4].max() < 0.1
    for value in (0.2, 0.8):
        assert said[chance == value, 8].mean().item() == pytest.approx(value, abs=0.1)
