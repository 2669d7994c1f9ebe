"""Critics."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded

from zfall.modules.critics import gru_critic, mlp_critic


@pytest.mark.parametrize("build", [mlp_critic, gru_critic])
def test_critic_gives_one_value_per_world(build):
    spec = Composite({"observation_critic": Unbounded((2, 484))}, shape=(2,))
    td = TensorDict({"observation_critic": torch.randn(2, 484), "is_init": torch.ones(2, 1).bool(),
                     "recurrent_state_critic": torch.zeros(2, 3, 64)}, batch_size=[2])  # fmt: skip
    assert build(spec)(td)["state_value"].shape == (2, 1)


@pytest.mark.parametrize("build", [mlp_critic, gru_critic])
def test_scale_is_the_unit_of_the_values(build):
    spec = Composite({"observation_critic": Unbounded((2, 484))}, shape=(2,))
    td = TensorDict({"observation_critic": torch.randn(2, 484), "is_init": torch.ones(2, 1).bool(),
                     "recurrent_state_critic": torch.zeros(2, 3, 64)}, batch_size=[2])  # fmt: skip
    one, many = build(spec), build(spec, scale=50.0)
    many.load_state_dict(one.state_dict())
    assert_close(many(td.clone())["state_value"], 50 * one(td.clone())["state_value"])
