"""The predictor of falls: steps and sequences agree, and it learns what can be known."""

import math

import pytest
import torch
from tensordict import TensorDict

from recipes.falling.trigger import History, calibrate, labels, learned, probabilities, table
from zfall.falling.fall_network import (
    SHIPPED,
    FallNetwork,
    load_fall_network,
    save_fall_network,
)
from zfall.falling.modes import FallPredictor


@pytest.fixture
def network() -> FallNetwork:
    torch.manual_seed(0)
    network = FallNetwork(6, 8)
    network.normalizer.update(torch.randn(100, 6))
    return network


def test_steps_equal_the_sequence(network):
    sequence = torch.randn(4, 20, 6)
    network.slope.fill_(1.7)
    network.offset.fill_(-0.3)
    whole = torch.sigmoid(1.7 * network.logits(sequence)[0] - 0.3)
    memory = torch.zeros(4, 8)
    for step in range(20):
        probability, memory = network(sequence[:, step], memory)
        torch.testing.assert_close(probability[:, 0], whole[:, step])


def test_a_file_gives_the_network_back(network, tmp_path):
    save_fall_network(network, tmp_path / "net.pt")
    again = load_fall_network(str(tmp_path / "net.pt"))
    sequence = torch.randn(2, 5, 6)
    assert torch.equal(again.logits(sequence)[0], network.logits(sequence)[0])
    with pytest.raises(ValueError, match="no such file"):
        load_fall_network(str(tmp_path / "none.pt"))


def test_a_network_sees_what_it_was_trained_with_or_is_refused(make_base, network, tmp_path):
    """In that order, at that rate; the one that ships has 25 decisions per second."""
    keys = ["projected_gravity", "base_angular_velocity"]
    network.trained_with = {"keys": keys, "control_dt": 0.02}
    save_fall_network(network, tmp_path / "net.pt")
    again = load_fall_network(str(tmp_path / "net.pt"))
    FallPredictor(make_base(control_dt=0.02), network=again, keys=keys)
    with pytest.raises(ValueError, match="keys must be what the network was trained with"):
        FallPredictor(make_base(control_dt=0.02), network=again, keys=keys[::-1])
    with pytest.raises(ValueError, match="control_dt must be what .* with, 0.02, got 0.04"):
        FallPredictor(make_base(control_dt=0.04), network=again, keys=keys)
    shipped = load_fall_network()
    with pytest.raises(ValueError, match="control_dt must be what .* with, 0.04, got 0.02"):
        FallPredictor(make_base(control_dt=0.02), network=shipped, keys=SHIPPED["keys"])
    size = sum(make_base().observation_spec[k].shape[1:].numel() for k in SHIPPED["keys"][:4]) + 20
    assert shipped.gru.input_size == size  # and the targets of 20 joints


def test_one_that_ships_goes_by_its_name_unless_a_file_is_called_so(network, tmp_path, monkeypatch):
    """It sees three numbers more than the other one, the velocity of the center of mass."""
    name = "zeroth01_fall_network_com_velocity.pt"
    shipped = load_fall_network(name)
    assert shipped.trained_with["keys"] == [*SHIPPED["keys"], "com_velocity"]
    assert shipped.gru.input_size == load_fall_network().gru.input_size + 3
    monkeypatch.chdir(tmp_path)
    save_fall_network(network, tmp_path / name)
    assert load_fall_network(name).gru.input_size == 6


def test_the_transform_begins_anew_with_each_episode(make_base, network):
    env = make_base(num_envs=3)
    keys = ["projected_gravity", "base_angular_velocity"]
    predictor = FallPredictor(env, network=network, keys=keys)
    sequence = torch.randn(4, 3, 6)
    for step in range(4):
        if step == 2:
            reset = TensorDict({"_reset": torch.tensor([[False], [True], [False]])}, [3])
            predictor._reset(reset, TensorDict(batch_size=[3]))
        measured = dict(zip(keys, sequence[step].split(3, -1), strict=True))
        td = predictor._step(TensorDict(batch_size=[3]), TensorDict(measured, batch_size=[3]))
    whole = torch.sigmoid(network.logits(sequence.transpose(0, 1))[0][:, -1])
    short = torch.sigmoid(network.logits(sequence[2:].transpose(0, 1))[0][:, -1])
    expected = torch.stack([whole[0], short[1], whole[2]])
    torch.testing.assert_close(td["fall_probability"][:, 0], expected)


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


def test_before_the_push_no_fall_is_sure():
    history = made_up()
    truth = labels(history)
    assert (truth[:, :5] == 0).all()
    assert torch.equal(truth[:, 5:], history.fell[:, None].float().expand(-1, 7))


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
    rows = table("network", history, learned(early), 0.04).set_index("setting")
    assert rows.loc["0.5", "detected"] == 0.0
    rows = table("network", history, learned(probability), 0.04).set_index("setting")
    assert rows.loc["0.5", "detected"] == 0.5
    assert rows.loc["0.5", "lead_s"] == pytest.approx(0.2)
    assert rows.loc["0.5", "false_alarms"] == 1.0
    assert rows.loc["0.8", "false_alarms"] == 0.0
