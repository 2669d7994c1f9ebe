"""A policy that explores by noise of its env."""

import pytest
import torch
from scipy.stats import norm
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type

from zfall.modules.actors import gru_actor, mlp_actor
from zfall.modules.exploring import ExploringActor

SPECS = Composite(observation=Unbounded((5, 4)), shape=(5,)), Bounded(-1.0, 1.0, (5, 3))


def test_noise_moves_the_action_by_the_deviation_and_is_as_likely_as_scipy_says():
    torch.manual_seed(0)
    actor = mlp_actor(*SPECS, num_cells=[8], std=0.2, normalize=False)
    td = TensorDict({"observation": torch.randn(5, 4), "exploration_noise": torch.randn(5, 3)}, [5])
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        mean = ExploringActor(actor)(td.clone())["action"]
        torch.testing.assert_close(mean, actor(td.clone())["action"])
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        out = ExploringActor(actor)(td.clone())
    torch.testing.assert_close(out["action"], mean + 0.2 * td["exploration_noise"])
    expected = norm.logpdf(0.2 * td["exploration_noise"].numpy(), scale=0.2).sum(1)
    torch.testing.assert_close(out["action_log_prob"].numpy(), expected.astype("float32"))


def test_a_policy_with_memory_or_of_another_head_is_refused():
    wanted = "actor must be a plain Gaussian without memory"
    with pytest.raises(ValueError, match=f"{wanted} .*, got MixtureOfGaussians"):
        ExploringActor(mlp_actor(*SPECS, num_cells=[8], components=2))
    with pytest.raises(ValueError, match=f"{wanted} .*, got a memory"):
        ExploringActor(gru_actor(*SPECS, hidden_size=4, num_layers=1))
