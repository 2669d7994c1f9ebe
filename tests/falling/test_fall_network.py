"""The network that predicts falls: steps and sequences agree, files give it back."""

import pytest
import torch

from zfall.falling.fall_network import SHIPPED, load_fall_network, save_fall_network


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


def test_one_that_ships_goes_by_its_name_unless_a_file_is_called_so(network, tmp_path, monkeypatch):
    """It sees three numbers more than the other one, the velocity of the center of mass."""
    name = "zeroth01_fall_network_com_velocity.pt"
    shipped = load_fall_network(name)
    assert shipped.trained_with["keys"] == [*SHIPPED["keys"], "com_velocity"]
    assert shipped.gru.input_size == load_fall_network().gru.input_size + 3
    monkeypatch.chdir(tmp_path)
    save_fall_network(network, tmp_path / name)
    assert load_fall_network(name).gru.input_size == 6
