"""PPO's loss as the config names it."""

import pytest
import torch
from torch.testing import assert_close

from zfall.losses.ppo import PenalizedPPOLoss
from zfall.training.checks import check_config
from zfall.training.learner import Learner

SIZES = ("num_envs=4", "rollout_steps=4", "epochs=2", "minibatches=3")
HERE = "+loss._target_=tests.training.test_losses."


class OwnWeights(PenalizedPPOLoss):
    """With a number that nothing would train."""

    def __init__(self, *networks, **values):
        super().__init__(*networks, **values)
        self.bias = torch.nn.Parameter(torch.zeros(()))


class Counting(PenalizedPPOLoss):
    """Remembers how often it was asked, and how its actor was at the start."""

    def __init__(self, *networks, first: int, **values):
        super().__init__(*networks, **values)
        self.register_buffer("times", torch.tensor(first))
        self.convert_to_functional(networks[0], "slow_network", create_target_params=True)

    def forward(self, tensordict):
        self.times += 1
        return super().forward(tensordict)


class Timed(PenalizedPPOLoss):
    """Learns from the first half of a second of an episode alone."""

    def set_keys(self, **keys):
        super().set_keys(**keys)
        self.in_keys = [*self.in_keys, "step_count"]

    def forward(self, tensordict):
        early = tensordict["step_count"] < 12
        return super().forward(tensordict.copy().set("advantage", tensordict["advantage"] * early))


def test_what_an_own_ppo_remembers_is_resumed(compose_config):
    """Two passes of three minibatches, begun at 100; the slow network stays where it began."""
    learner = Learner(compose_config(HERE + "Counting", "+loss.first=100", *SIZES))
    begun = learner.loss.target_slow_network_params.clone()
    for _ in range(2):
        learner.learn(learner.collect())
    resumed = Learner(compose_config(HERE + "Counting", "+loss.first=0", "seed=5", *SIZES))
    resumed.load_state_dict(learner.state_dict())
    assert resumed.loss.times == 112
    assert_close(resumed.loss.target_slow_network_params.to_dict(), begun.to_dict())
    assert (resumed.loss.target_slow_network_params != learner.loss.actor_network_params).any()


def test_an_own_ppo_gets_what_it_reads(compose_config):
    learner = Learner(compose_config(HERE + "Timed", *SIZES))
    learner.learn(learner.collect())
    assert "step_count" in learner._learned


def test_keys_of_the_class_go_to_it(compose_config):
    """What the recipe would set by itself too, and what refers to the rest of the config."""
    own = (HERE + "Counting", "+loss.loss_critic_type=smooth_l1", "+loss.first=${seed}", "seed=7")
    loss = Learner(compose_config(*own, *SIZES)).loss
    assert loss.loss_critic_type == "smooth_l1"
    assert loss.times == 7
    assert Learner(compose_config(*SIZES)).loss.loss_critic_type == "l2"


FAULTS = [
    ([HERE + "Nothing"], "loss._target_ must name something that Python can .* has no Nothing"),
    (["+loss._target_=torch"], "loss._target_ must name .* got torch: it cannot be called"),
    (["+loss._target_=null"], "loss._target_ must be the dotted path of a class, got None"),
    (["+loss._target_=torchrl.objectives.ClipPPOLoss"],
     "loss._target_ must name a class that is a zfall.losses.ppo.PenalizedPPOLoss, got torchrl"),
    ([HERE + "Counting", "+loss.first=1", "+loss._partial_=true"], "loss must be built when"),
    ([HERE + "Counting", "+loss.frist=1"], "loss.frist is not a key .* did you mean first"),
    ([HERE + "Counting", "+loss.first=1", "+loss.kl_stopp=1"], "loss.kl_stopp is not a key"),
]  # fmt: skip


@pytest.mark.parametrize(("overrides", "message"), FAULTS, ids=[str(o) for o, _ in FAULTS])
def test_faults_are_refused_before_anything_is_built(compose_config, overrides, message):
    with pytest.raises(ValueError, match=message):
        check_config(compose_config(*overrides))


def test_a_value_that_the_class_misses_is_named_with_its_place(compose_config):
    with pytest.raises(ValueError, match=r"loss\.first must be given, a whole number"):
        Learner(compose_config(HERE + "Counting", *SIZES))


def test_weights_of_its_own_are_refused(compose_config):
    with pytest.raises(ValueError, match=r"loss must have no parameters but .* its bias"):
        Learner(compose_config(HERE + "OwnWeights", *SIZES))
