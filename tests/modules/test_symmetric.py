"""Networks that are the same on both sides, whatever their weights."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Composite, Unbounded

from zfall.modules.actors import mlp_actor
from zfall.modules.deployed import DeployedPolicy
from zfall.modules.mirror import Mirror
from zfall.modules.symmetric import SymmetricPolicy, SymmetricValue, TaskMirror

# Of an observation (forward, left, arm, other arm) and of the action (arm, other arm).
SEEN = Mirror(torch.tensor([0, 1, 3, 2]), torch.tensor([1.0, -1.0, 1.0, 1.0]))
DONE = Mirror(torch.tensor([1, 0]), torch.tensor([1.0, 1.0]))


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

    There the means are (-3, 2), whose image is (2, -3); here they are (3, 2). The deviations are
    (1.5, 3) here and (1.1, 3) there, exchanged (3, 1.1).
    """
    policy = told(SymmetricPolicy(Formula(), 4, 2))
    loc, scale = policy(torch.tensor([2.0, 3.0, 0.5, 0.1]))
    torch.testing.assert_close(loc, torch.tensor([2.5, -0.5]))
    torch.testing.assert_close(scale, torch.tensor([2.25, 2.05]))


def test_the_mirrored_observation_has_the_mirrored_distribution_and_the_same_value():
    net = nn.Sequential(nn.Linear(4, 8), nn.Tanh(), nn.Linear(8, 4))
    halves = nn.Sequential(net, Halves())
    policy, value = told(SymmetricPolicy(halves, 4, 2)), told(SymmetricValue(net, 4))
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
    assert torch.equal(SymmetricPolicy(Formula(), 4, 2).seen(x), x)


def test_the_mirrors_are_saved_with_the_weights():
    spec = Composite(observation=Unbounded((1, 4)), batch_size=(1,))
    action = Unbounded((1, 2))
    one, other = (mlp_actor(spec, action, symmetric=True) for _ in range(2))
    told(one)
    weights = one.state_dict()
    assert all(value.isfinite().all() for value in weights.values())
    other.load_state_dict(weights)
    x = torch.randn(5, 4)
    seen, image = (TensorDict({"observation": each}, (5,)) for each in (x, SEEN(x)))
    mean = one.get_dist(seen).mean
    torch.testing.assert_close(other.get_dist(image).mean, DONE(mean))
    torch.testing.assert_close(DeployedPolicy(other)(x), mean)  # as it is exported


def test_a_mixture_is_refused():
    spec = Composite(observation=Unbounded((1, 4)), batch_size=(1,))
    with pytest.raises(ValueError, match="symmetric must be false for a mixture, got components=2"):
        mlp_actor(spec, Unbounded((1, 2)), symmetric=True, components=2)
