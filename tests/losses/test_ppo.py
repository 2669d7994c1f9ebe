"""The penalised loss against TorchRL's, closed forms and hand calculation."""

import numpy as np
import pytest
import torch
from scipy.stats import norm
from tensordict import TensorDict, TensorDictBase
from torch.distributions import Normal, kl_divergence
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss

from zfall.losses.ppo import PenalizedPPOLoss
from zfall.modules.actors import mlp_actor
from zfall.modules.critics import mlp_critic

COMMON = {"clip_epsilon": 0.3, "critic_coeff": 0.7, "entropy_coeff": 0.01,
          "loss_critic_type": "l2", "normalize_advantage": True}  # fmt: skip


def specs(joints: int = 2) -> tuple[Composite, Unbounded]:
    shapes = {"observation": Unbounded((1, 3)), "observation_critic": Unbounded((1, 4))}
    return Composite(shapes, shape=(1,)), Unbounded((1, joints))


def collected(actor: ProbabilisticActor, rows: int) -> TensorDictBase:
    """Actions of the actor, with whatever else the loss reads."""
    batch = TensorDict({"observation": torch.randn(rows, 3)}, [rows])
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        batch = actor(batch)
    batch["observation_critic"] = torch.randn(rows, 4)
    for key in ("advantage", "value_target", "state_value"):
        batch[key] = torch.randn(rows, 1)
    return batch


def move(actor: torch.nn.Module, size: float) -> None:
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.add_(size * torch.randn_like(parameter))


@pytest.mark.parametrize("value_clip", [None, 0.2])
@pytest.mark.parametrize("components", [0, 3])
def test_without_penalty_and_bound_it_is_the_clipped_loss(components, value_clip):
    spec, action_spec = specs()
    actor, critic = mlp_actor(spec, action_spec, components=components), mlp_critic(spec)
    batch = collected(actor, 64)
    move(actor, 0.05)
    expected = ClipPPOLoss(actor, critic, clip_value=value_clip, **COMMON)(batch)
    out = PenalizedPPOLoss(actor, critic, value_clip=value_clip, **COMMON)(batch)
    assert set(out.keys()) == {*expected.keys(), "kl"}
    for key, value in expected.items():
        assert torch.equal(out[key], value), key


@pytest.mark.parametrize("normalize", [False, True])
@pytest.mark.parametrize("components", [0, 3])
def test_objective_and_entropy_are_those_of_a_plain_loop(components, normalize):
    """Densities by SciPy, row by row and joint by joint; entropy by sums over a fine grid."""
    spec, action_spec = specs()
    actor, critic = mlp_actor(spec, action_spec, components=components), mlp_critic(spec)
    batch = collected(actor, 40)
    move(actor, 0.1)
    out = PenalizedPPOLoss(actor, critic, **(COMMON | {"normalize_advantage": normalize}))(batch)
    with torch.no_grad():
        dist = actor.get_dist(batch.clone())
    if components:
        weight, loc, scale = dist.logits.softmax(-1).numpy(), dist.loc.numpy(), dist.scale.numpy()
    else:
        loc, scale = dist.base_dist.loc.numpy()[..., None], dist.base_dist.scale.numpy()[..., None]
        weight = np.ones_like(loc)
    grid = np.linspace(-12, 12, 40_001)
    advantage = batch["advantage"][:, 0].double().numpy()
    if normalize:
        advantage = (advantage - advantage.mean()) / advantage.std(ddof=1)
    gains, entropies, clipped = [], [], 0
    for row in range(40):
        log_prob = entropy = 0.0
        for joint in range(2):
            here = (weight[row, joint], loc[row, joint], scale[row, joint])
            density = lambda x, here=here: (here[0] * norm.pdf(x[:, None], *here[1:])).sum(-1)  # noqa: E731
            log_prob += np.log(density(batch["action"][row, joint : joint + 1].numpy()))[0]
            values = density(grid)
            entropy -= (values * np.log(values.clip(1e-300))).sum() * (grid[1] - grid[0])
        ratio = np.exp(log_prob - batch["action_log_prob"][row].item())
        bounded = min(max(ratio, 0.7), 1.3)
        clipped += ratio != bounded
        gains.append(min(ratio * advantage[row], bounded * advantage[row]))
        entropies.append(entropy)
    assert 0 < clipped < 40
    assert out["loss_objective"].item() == pytest.approx(-np.mean(gains), abs=1e-4)
    assert out["loss_entropy"].item() == pytest.approx(-0.01 * np.mean(entropies), abs=1e-5)
    out["loss_entropy"].backward()
    assert max(p.grad.abs().max() for p in actor.parameters() if p.grad is not None) > 1e-4


def test_the_penalty_leaves_the_other_losses_as_they_are():
    spec, action_spec = specs()
    actor, critic = mlp_actor(spec, action_spec), mlp_critic(spec)
    batch = collected(actor, 64)
    move(actor, 0.05)
    loss = PenalizedPPOLoss(actor, critic, kl_coeff=0.2, **COMMON)
    out, plain = loss(batch), ClipPPOLoss(actor, critic, **COMMON)(batch)
    assert set(loss.out_keys) >= {"loss_kl", "kl_coeff"}
    assert set(out.keys()) == {*plain.keys(), "kl", "loss_kl", "kl_coeff"}
    for key, value in plain.items():
        assert torch.equal(out[key], value), key


def test_penalty_estimates_the_divergence_of_gaussians_and_its_gradient():
    """Mean over 400 000 actions of one observation against torch's closed form."""
    spec, action_spec = specs()
    actor = mlp_actor(spec, action_spec, num_cells=[8], std=0.3, normalize=False)
    critic = mlp_critic(spec, num_cells=[8])
    rows = 400_000
    batch = TensorDict({"observation": torch.randn(1, 3).expand(rows, 3)}, [rows])
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        old = actor.get_dist(batch[:1])
        batch = actor(batch)
    batch["observation_critic"] = torch.zeros(rows, 4)
    for key in ("advantage", "value_target"):
        batch[key] = torch.randn(rows, 1)
    move(actor, 0.08)
    head = actor.module[0].module[-1]
    parameters = [head.mean.bias, head.log_std]
    loss = PenalizedPPOLoss(actor, critic, kl_coeff=0.5, **COMMON)(batch)["loss_kl"]
    estimate = torch.autograd.grad(loss, parameters)
    new = actor.get_dist(batch[:1])
    before, after = (Normal(dist.mean, dist.variance.sqrt()) for dist in (old, new))
    exact = kl_divergence(before, after).sum()
    gradient = torch.autograd.grad(exact, parameters)
    assert 0.02 < exact.item() < 0.5
    assert loss.item() == pytest.approx(0.5 * exact.item(), rel=0.02)
    for mine, theirs in zip(estimate, gradient, strict=True):
        assert_close(mine, 0.5 * theirs, atol=0.01, rtol=0.02)
        assert theirs.abs().max() > 0.1


def test_penalty_vanishes_with_its_gradient_where_the_policy_has_not_moved():
    spec, action_spec = specs()
    actor, critic = mlp_actor(spec, action_spec, components=3), mlp_critic(spec)
    out = PenalizedPPOLoss(actor, critic, kl_coeff=1.0, **COMMON)(collected(actor, 64))
    assert abs(out["loss_kl"].item()) < 1e-6
    gradients = torch.autograd.grad(out["loss_kl"], list(actor.parameters()))
    assert max(gradient.abs().max() for gradient in gradients) < 1e-5


def penalty(**values: float | None) -> PenalizedPPOLoss:
    spec, action_spec = specs()
    return PenalizedPPOLoss(mlp_actor(spec, action_spec), mlp_critic(spec), **values, **COMMON)


def test_weight_of_the_penalty_follows_its_target():
    """By half below half of it, times 1.5 above twice, else as it is."""
    loss = penalty(kl_coeff=0.2, kl_target=0.01)
    for divergence, expected in [(0.021, 0.3), (0.019, 0.3), (0.006, 0.3), (0.004, 0.15)]:
        loss.adapt(divergence)
        assert loss.kl_coeff.item() == pytest.approx(expected)


def test_weight_of_the_penalty_comes_back_from_the_longest_quiet():
    """Twenty halvings are a millionth: no more of them count, 35 updates of 1.5 undo them all."""
    loss = penalty(kl_coeff=0.2, kl_target=0.01)
    for _ in range(200):
        loss.adapt(0.001)
    assert loss.kl_coeff.item() == pytest.approx(0.2e-6)
    for _ in range(35):
        loss.adapt(1.0)
    assert loss.kl_coeff.item() == pytest.approx(0.2e-6 * 1.5**35, rel=1e-4)


def test_weight_without_a_target_stays():
    loss = penalty(kl_coeff=0.2)
    loss.adapt(1.0)
    assert loss.kl_coeff.item() == pytest.approx(0.2)


def critic_loss(
    value: float, old: float, target: float | list[float], **bounds: float
) -> tuple[float, float]:
    """Loss of a critic that says ``value`` everywhere, and its gradient in that value."""
    spec, action_spec = specs()
    actor, linear = mlp_actor(spec, action_spec), torch.nn.Linear(4, 1)
    critic = ValueOperator(linear, in_keys=["observation_critic"])
    with torch.no_grad():
        linear.weight.zero_()
        linear.bias.fill_(value)
    batch = collected(actor, 8)
    batch["state_value"].fill_(old)
    targets = torch.as_tensor(target).reshape(-1, 1)
    batch["value_target"].copy_(targets.expand(8, 1))
    loss = PenalizedPPOLoss(actor, critic, **bounds, **COMMON)(batch)["loss_critic"]
    (gradient,) = torch.autograd.grad(loss, linear.bias)
    return loss.item() / 0.7, gradient.item() / 0.7


@pytest.mark.parametrize(
    ("value", "old", "target", "expected"),
    [
        (4.0, 3.5, 5.0, (1.0, -2.0)),  # it has changed by less than the bound: (4 - 5)^2
        (4.0, 0.0, 5.0, (9.0, 0.0)),  # as if it had stopped at 2: (2 - 5)^2, no gradient
        (4.0, 0.0, 2.5, (2.25, 3.0)),  # beyond the bound and the target: it goes back
    ],
)
def test_value_clip_bounds_the_change_that_pays(value, old, target, expected):
    assert critic_loss(value, old, target, value_clip=2.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("target", "expected"), [(5.0, (1.0, -2.0)), (8.0, (9.0, 0.0))], ids=["within", "beyond"]
)
def test_value_error_clip_bounds_the_squared_error(target, expected):
    assert critic_loss(4.0, 0.0, target, value_error_clip=9.0) == pytest.approx(expected)


def test_value_error_clip_bounds_each_sample_on_its_own():
    """Errors of 1 and 16 under a bound of 9: 5 in the mean, which is not their mean of 8.5."""
    targets = [5.0, 8.0] * 4
    assert critic_loss(4.0, 0.0, targets, value_error_clip=9.0) == pytest.approx((5.0, -1.0))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kl_coeff": -0.1}, "kl_coeff must not be negative, got -0.1"),
        ({"kl_target": 0.01}, "kl_target must be positive and go with a positive kl_coeff"),
        ({"kl_coeff": 0.2, "kl_target": 0.0}, "kl_target must be positive"),
        ({"value_clip": 0.0}, "value_clip must be positive or null, got 0.0"),
        ({"value_error_clip": -1.0}, "value_error_clip must be positive or null, got -1.0"),
    ],
)
def test_values_out_of_range_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        penalty(**values)


def test_divergence_is_that_of_the_samples_that_are_not_mirrored():
    spec, action_spec = specs()
    actor, critic = mlp_actor(spec, action_spec), mlp_critic(spec)
    loss = PenalizedPPOLoss(actor, critic, kl_coeff=2.0, **COMMON)
    batch = collected(actor, 64)
    move(actor, 0.05)
    kept = torch.arange(64) % 3 > 0
    alone = loss(batch[kept])
    assert alone["kl"] > 1e-3
    out = loss(batch.clone().set("mirrored", ~kept))
    for key in ("kl", "loss_kl"):
        assert_close(out[key], alone[key])
    assert not torch.isclose(loss(batch)["kl"], alone["kl"], rtol=1e-3)
    assert loss(batch.set("mirrored", torch.ones(64, dtype=torch.bool)))["kl"] == 0.0
