"""Critics."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded

from zfall.modules.actors import mlp_actor, normalizer_of
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


def test_critic_can_share_the_normaliser_of_an_actor_that_sees_the_same():
    shapes = {"observation": Unbounded((2, 7)), "observation_critic": Unbounded((2, 7))}
    spec = Composite(shapes, shape=(2,))
    shared = normalizer_of(mlp_actor(spec, Unbounded((2, 3))))
    critic = mlp_critic(spec, normalize=shared)
    assert normalizer_of(critic) is shared
    td = TensorDict({"observation_critic": torch.randn(2, 7)}, batch_size=[2])
    before = critic(td.clone())["state_value"]
    shared.update(5.0 + torch.randn(100, 7))
    assert not torch.allclose(critic(td.clone())["state_value"], before)
    other = Composite({"observation_critic": Unbounded((2, 8))}, shape=(2,))
    with pytest.raises(ValueError, match="must have the size of the observation, 8, got 7"):
        mlp_critic(other, normalize=shared)


@pytest.mark.parametrize("scale", [0.0, -5.0, float("inf")])
def test_a_unit_that_is_none_is_refused(scale):
    spec = Composite(observation_critic=Unbounded((6,)))
    with pytest.raises(ValueError, match="scale must be positive and finite, got"):
        mlp_critic(spec, scale=scale)
