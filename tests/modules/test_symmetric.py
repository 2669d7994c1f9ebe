"""Networks that are the same on both sides, whatever their weights."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Binary, Composite, Unbounded
from torchrl.modules import set_recurrent_mode

from zfall.modules.actors import gru_actor, mlp_actor, recurrent_keys
from zfall.modules.critics import mlp_critic
from zfall.modules.deployed import DeployedPolicy
from zfall.modules.mirror import Mirror
from zfall.modules.symmetric import SymmetricPolicy, SymmetricValue, TaskMirror

# Of an observation (forward, left, arm, other arm) and of the action (arm, other arm).
SEEN = Mirror(torch.tensor([0, 1, 3, 2]), torch.tensor([1.0, -1.0, 1.0, 1.0]))
DONE = Mirror(torch.tensor([1, 0]), torch.tensor([-1.0, -1.0]))
GAUSSIAN = ("loc", "scale")
SPEC = Composite(
    observation=Unbounded((1, 4)), is_init=Binary(shape=(1, 1), dtype=torch.bool), batch_size=(1,)
)


class Task:
    """Gives these mirrors."""

    def mirror(self, key):
        return {"observation": SEEN, "observation_critic": SEEN, "action": DONE}[key]


class Formula(nn.Module):
    """A mean and a deviation that can be worked out by hand."""

    def forward(self, x):
        forward, left, arm, other = x.unbind(-1)
        return torch.stack([left, forward], -1), torch.stack([1 + arm, 3 + 0 * other], -1)


def told(network):
    for part in network.modules():
        if isinstance(part, TaskMirror):
            part.for_task(Task())
    return network


def test_it_is_the_mean_of_what_is_done_here_and_in_the_mirror():
    """o = (2, 3, 0.5, 0.1) has the image (2, -3, 0.1, 0.5).

    There the means are (-3, 2), whose image is (-2, 3); here they are (3, 2). The deviations are
    (1.5, 3) here and (1.1, 3) there, exchanged (3, 1.1).
    """
    policy = told(SymmetricPolicy(Formula(), GAUSSIAN, 4, 2))
    loc, scale = policy(torch.tensor([2.0, 3.0, 0.5, 0.1]))
    torch.testing.assert_close(loc, torch.tensor([0.5, 2.5]))
    torch.testing.assert_close(scale, torch.tensor([2.25, 2.05]))


def test_the_mirrored_observation_has_the_mirrored_distribution_and_the_same_value():
    net = nn.Sequential(nn.Linear(4, 8), nn.Tanh(), nn.Linear(8, 4))
    halves = nn.Sequential(net, Halves())
    policy, value = told(SymmetricPolicy(halves, GAUSSIAN, 4, 2)), told(SymmetricValue(net, 4))
    x = torch.randn(5, 3, 4)
    (loc, scale), (image, image_scale) = policy(x), policy(SEEN(x))
    torch.testing.assert_close(image, DONE(loc))
    torch.testing.assert_close(image_scale, scale.flip(-1))
    torch.testing.assert_close(value(SEEN(x)), value(x))
    assert (net(SEEN(x)) - net(x)).abs().max() > 0.1


class Halves(nn.Module):
    """Two outputs as means, two as deviations."""

    def forward(self, x):
        loc, raw = x.chunk(2, -1)
        return loc, raw.exp()


def test_before_the_task_is_known_nothing_is_mirrored():
    x = torch.randn(3, 4)
    assert torch.equal(SymmetricPolicy(Formula(), GAUSSIAN, 4, 2).seen(x), x)


def test_the_mirrors_are_saved_with_the_weights():
    one, other = (mlp_actor(SPEC, Unbounded((1, 2)), symmetric=True) for _ in range(2))
    told(one)
    weights = one.state_dict()
    assert all(value.isfinite().all() for value in weights.values())
    other.load_state_dict(weights)
    x = torch.randn(5, 4)
    seen, image = (TensorDict({"observation": each}, (5,)) for each in (x, SEEN(x)))
    mean = one.get_dist(seen).mean
    torch.testing.assert_close(other.get_dist(image).mean, DONE(mean))
    torch.testing.assert_close(DeployedPolicy(other)(x), mean)  # as it is exported


@pytest.mark.parametrize("components", [0, 3])
@pytest.mark.parametrize("residual", [False, True])
def test_a_policy_with_a_memory_is_symmetric_along_a_sequence(components, residual):
    """Also where an episode begins on the way; the memories of here and there change places."""
    cells = {"hidden_size": 8, "num_layers": 2, "encoder_cells": [8], "num_cells": [8]}
    mixed = {"components": components, "symmetric": True, "residual": residual}
    actor = told(gru_actor(SPEC, Unbounded((1, 2)), **cells, **mixed))
    for weights in actor.parameters():
        torch.nn.init.normal_(weights, 0.0, 0.5)
    begins = torch.zeros(3, 6, 1, dtype=torch.bool)
    begins[1, 3] = True
    x, keys = torch.randn(3, 6, 4), recurrent_keys(actor)
    memory = {key: torch.randn(3, 6, 2, 8) for key in keys}
    swapped = dict(zip(keys, reversed(memory.values()), strict=True))
    with set_recurrent_mode(True):
        here, there = (
            actor.get_dist(TensorDict({"observation": seen, "is_init": begins, **own}, (3, 6)))
            for seen, own in ((x, memory), (SEEN(x), swapped))
        )
    action = torch.randn(3, 6, 2)
    torch.testing.assert_close(there.log_prob(DONE(action)), here.log_prob(action))
    assert (there.log_prob(action) - here.log_prob(action)).abs().max() > 0.1
    memory = {key: value[:, 0] for key, value in memory.items()}
    for t in range(6):  # step by step, as it acts
        step = TensorDict({"observation": x[:, t], "is_init": begins[:, t], **memory}, (3,))
        after = actor.get_dist(step)
        torch.testing.assert_close(after.log_prob(action[:, t]), here.log_prob(action)[:, t])
        memory = {key: value for key, value in actor(step)["next"].items() if key in keys}


@pytest.mark.parametrize("make", [mlp_actor, gru_actor])
def test_a_robot_that_prefers_the_other_side_is_its_mirror_image(make):
    """Both have the same weights; with 0 it prefers none."""
    mean = {}
    for preferred in (0.7, -0.7, 0.0):
        torch.manual_seed(0)
        actor = told(make(SPEC, Unbounded((1, 2)), symmetric=True, handedness=preferred))
        for weights in actor.parameters():
            torch.nn.init.normal_(weights, 0.0, 0.3)
        x = torch.randn(5, 4)
        memory = {key: torch.zeros(5, 3, 64) for key in recurrent_keys(actor)}
        starts = {"is_init": torch.ones(5, 1, dtype=torch.bool), **memory}
        for name, seen in (("here", x), ("there", SEEN(x))):
            given = TensorDict({"observation": seen, **starts}, (5,))
            mean[preferred, name] = actor.get_dist(given).deterministic_sample.detach()
    torch.testing.assert_close(mean[-0.7, "there"], DONE(mean[0.7, "here"]))
    torch.testing.assert_close(mean[0.0, "there"], DONE(mean[0.0, "here"]))
    assert (mean[0.7, "there"] - DONE(mean[0.7, "here"])).abs().max() > 0.01


def test_the_value_may_differ_between_the_sides_of_one_who_prefers_one():
    spec = Composite(observation_critic=Unbounded((1, 4)), batch_size=(1,))
    x = torch.randn(5, 4)
    for handedness in (None, 0.0, 1.0):
        critic = told(mlp_critic(spec, symmetric=True, handedness=handedness))
        here, there = (
            critic(TensorDict({"observation_critic": seen}, (5,)))["state_value"]
            for seen in (x, SEEN(x))
        )
        assert torch.allclose(here, there, atol=1e-6) == (not handedness)


def test_who_has_no_other_side_prefers_none():
    with pytest.raises(ValueError, match="handedness must be null unless symmetric is true"):
        mlp_actor(SPEC, Unbounded((1, 2)), handedness=1.0)


def test_a_mixture_over_the_whole_action_is_refused():
    for make in (mlp_actor, gru_actor):
        with pytest.raises(ValueError, match="symmetric must be false with shared_components"):
            make(SPEC, Unbounded((1, 2)), symmetric=True, components=2, shared_components=True)
