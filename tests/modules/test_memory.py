"""Networks with a memory: what they do when it is taken away."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type
from torchrl.modules import LSTMModule

from zfall.modules.actors import gru_actor, mlp_actor
from zfall.modules.memory import WithoutMemory

SPEC = Composite({"observation": Unbounded((4, 5))}, shape=(4,))
ACTION = Unbounded((4, 3))


def steps(network, hidden, steps=3):
    """What a network gives step by step, with what it remembers put back in."""
    torch.manual_seed(0)
    found, memory = [], hidden
    for _ in range(steps):
        seen = TensorDict({"observation": torch.randn(4, 5), **memory}, [4])
        seen["is_init"] = torch.zeros(4, 1, dtype=torch.bool)
        network(seen)
        memory = {key: seen["next", key] for key in hidden}
        found.append(seen)
    return found


def test_a_gru_without_memory_gives_what_a_first_step_gives():
    torch.manual_seed(1)
    actor = gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2, components=0)
    for parameter in actor.parameters():
        nn.init.normal_(parameter, std=0.5)
    beginning = {"recurrent_state_actor": torch.zeros(4, 2, 8)}
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        own, without = (steps(each, beginning) for each in (actor, WithoutMemory(actor)))
        for number, (one, other) in enumerate(zip(own, without, strict=True)):
            first = TensorDict({"observation": other["observation"], **beginning}, [4])
            first["is_init"] = torch.ones(4, 1, dtype=torch.bool)
            expected = actor.get_dist(first).mean
            assert_close(other["action"], expected)
            assert number == 0 or not torch.allclose(one["action"], expected)


def test_every_hidden_state_is_put_back_to_where_it_begins():
    torch.manual_seed(1)
    network = LSTMModule(
        5, 6, in_keys=["observation", "h", "c"], out_keys=["out", ("next", "h"), ("next", "c")]
    )
    beginning = {key: torch.zeros(4, 1, 6) for key in ("h", "c")}
    with torch.no_grad():
        for seen in steps(WithoutMemory(network), beginning):
            expected, _ = network.lstm(seen["observation"].unsqueeze(1))
            assert_close(seen["out"], expected.squeeze(1))


def test_what_has_no_memory_cannot_forget():
    with pytest.raises(ValueError, match="network must have a memory"):
        WithoutMemory(mlp_actor(SPEC, ACTION, num_cells=[8]))
