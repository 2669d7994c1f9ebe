"""How early a trigger is, and how often wrong."""

import pytest
import torch

from zfall.falling.trigger import History, learned, table


def test_lead_and_false_alarms_by_hand():
    live = torch.ones(3, 10, dtype=torch.bool)
    live[0, 8:], live[1, 6:] = False, False
    history = History(
        torch.zeros(3, 10, 1), torch.zeros(3, 10), torch.zeros(3, 10), live,
        torch.tensor([True, True, False]), torch.arange(10) >= torch.tensor([[2], [1], [2]]),
    )  # fmt: skip
    probability = torch.zeros(3, 10)
    probability[0, 3] = 0.9  # five steps ahead, and it goes down again
    probability[1, 7] = 0.9  # after the touch: too late
    probability[2, 4] = 0.6
    early = torch.zeros(3, 10)
    early[0, 1], early[1, 0] = 0.9, 0.9  # before the push of each, of which it knew nothing
    rows = table("network", history, learned(early, 0.04), 0.04).set_index("setting")
    assert rows.loc["0.5", "detected"] == 0.0
    # two alarms in 1 + 0 + 2 steps: a trial that was given up is watched no longer
    assert rows.loc["0.5", "alarms_per_hour"] == pytest.approx(2 / (3 * 0.04 / 3600))
    rows = table("network", history, learned(probability, 0.04), 0.04).set_index("setting")
    assert rows.loc["0.5", "detected"] == 0.5
    assert rows.loc["0.5", "lead_s"] == pytest.approx(0.2)
    assert rows.loc["0.5", "false_alarms"] == 1.0
    assert rows.loc["0.8", "false_alarms"] == 0.0
    assert rows.loc["0.5", "alarms_per_hour"] == 0.0


def test_the_network_must_be_sure_for_as_long_as_the_policy_asks_of_it():
    """0.04 s are one step at 25 Hz and two in a row at 50 Hz."""
    probability = torch.tensor([[0.0, 0.9, 0.0, 0.9, 0.9, 0.0]])
    for control_dt, first in ((0.04, 1), (0.02, 4)):
        state = learned(probability, control_dt)["0.8"][0]
        assert state.int().argmax() == first
        assert state[first:].all()
