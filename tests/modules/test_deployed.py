"""Policies without TensorDicts."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type
from torchrl.modules import IndependentNormal, ProbabilisticActor, TanhNormal

from zfall.modules.actors import gru_actor, mlp_actor
from zfall.modules.deployed import deployed, memories_at_start

SPEC = Composite(observation=Unbounded((1, 12)), shape=(1,))
ACTION = Unbounded((1, 5))


def test_plain_modules_need_no_tensordict():
    actor = gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2, statistic="mode")
    action, memory = deployed(actor)(torch.zeros(1, 12), *memories_at_start(actor).values())
    assert action.shape == (1, 5)
    assert memory.shape == (1, 2, 8)


def reading_more(key: str):
    """An actor whose head also reads another key."""
    actor = mlp_actor(SPEC, ACTION, num_cells=[8])
    gate = TensorDictModule(lambda loc, other: loc * other, ["loc", key], ["loc"])
    return ProbabilisticActor(
        TensorDictSequential(actor[0], gate),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
    )


@pytest.mark.parametrize(
    ("key", "rule"),
    [
        ("command", "sees the observation alone .* got observation, command"),
        ("is_init", "policy of TensorDictModule, GRUModule and LSTMModule .* got TensorDictModule"),
    ],
)
def test_what_a_robot_does_not_have_is_refused(key, rule):
    with pytest.raises(ValueError, match=rule):
        deployed(reading_more(key))


def test_parameters_under_other_names_and_another_distribution():
    """A squashed Gaussian acts by the squashed mean, a plain one by its ``loc`` however called."""
    actor = mlp_actor(SPEC, ACTION, num_cells=[8])
    net = TensorDictModule(actor[0].module, ["observation"], ["mu", "sigma"])
    for kind in (TanhNormal, IndependentNormal):
        own = ProbabilisticActor(
            net, in_keys={"loc": "mu", "scale": "sigma"}, distribution_class=kind
        )
        seen = torch.randn(3, 12)
        with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
            expected = own(TensorDict({"observation": seen}, [3]))["action"]
            assert_close(deployed(own)(seen), expected)


def test_an_actor_without_a_plain_form_says_why():
    class Refusing(torch.nn.Module):
        not_deployed = "run must hold one policy."

    with pytest.raises(ValueError, match="run must hold one policy"):
        deployed(Refusing())
