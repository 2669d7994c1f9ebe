"""Policies without TensorDicts."""

import pytest
import torch
from torchrl.data import Composite, Unbounded

from zfall.modules.actors import gru_actor
from zfall.modules.deployed import deployed, zero_memory

SPEC = Composite(observation=Unbounded((1, 12)), shape=(1,))
ACTION = Unbounded((1, 5))


def test_plain_modules_need_no_tensordict():
    actor = gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2, statistic="mode")
    action, memory = deployed(actor)(torch.zeros(1, 12), zero_memory(actor))
    assert action.shape == (1, 5)
    assert memory.shape == (1, 2, 8)


def test_an_actor_without_a_plain_form_says_why():
    class Refusing(torch.nn.Module):
        not_deployed = "run must hold one policy."

    with pytest.raises(ValueError, match="run must hold one policy"):
        deployed(Refusing())
