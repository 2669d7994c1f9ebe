"""The probability of a fall, as a quantity of the env."""

import pytest
import torch
from tensordict import TensorDict

from zfall.falling.fall_network import SHIPPED, load_fall_network, save_fall_network
from zfall.falling.modes import FallPredictor


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


def test_what_lies_is_no_fall_to_come_and_who_recovers_anew_begins_anew(make_base, network):
    """Modes: recover, recover; kneel, recover; recover. The second world begins at the last step."""
    env = make_base(num_envs=2)
    keys = ["projected_gravity", "base_angular_velocity"]
    predictor = FallPredictor(env, network=network, keys=keys)
    sequence, said = torch.randn(3, 2, 6), []
    for step, kneels in enumerate([(0, 0), (0, 1), (0, 0)]):
        before = TensorDict({"mode": torch.eye(3)[list(kneels)]}, [2])
        measured = dict(zip(keys, sequence[step].split(3, -1), strict=True))
        td = predictor._step(before, TensorDict(measured, batch_size=[2]))
        said.append(td["fall_probability"][:, 0])
    assert said[1][1] == 0
    assert said[1][0] > 0
    whole = torch.sigmoid(network.logits(sequence.transpose(0, 1))[0][:, -1])
    short = torch.sigmoid(network.logits(sequence[2:].transpose(0, 1))[0][:, -1])
    torch.testing.assert_close(said[2], torch.stack([whole[0], short[1]]))
