"""The mixture over the whole action against SciPy's densities and closed forms."""

import math

import pytest
import torch
from scipy.stats import multivariate_normal
from torch.distributions import Independent, Normal, kl_divergence
from torch.testing import assert_close

from zfall.modules.shared_mixture import SharedMixtureOfGaussians

Parameters = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


@pytest.fixture
def shared() -> Parameters:
    return (
        torch.randn(30, 3).double(),
        torch.randn(30, 3, 4).double(),
        0.2 + torch.rand(30, 3, 4).double(),
    )


def test_shared_mixture_has_the_density_of_scipy(shared):
    logits, loc, scale = shared
    value = torch.randn(30, 4).double()
    ours = SharedMixtureOfGaussians(*shared)
    for row in range(30):
        density = sum(
            logits[row].softmax(-1)[k].item()
            * multivariate_normal.pdf(
                value[row].numpy(), loc[row, k].numpy(), (scale[row, k] ** 2).numpy()
            )
            for k in range(3)
        )
        assert ours.log_prob(value)[row].item() == pytest.approx(math.log(density), abs=1e-9)


def test_shared_mixture_draws_all_joints_from_one_component():
    loc = torch.tensor([[[-1.0, -1.0], [1.0, 1.0]]])
    ours = SharedMixtureOfGaussians(
        torch.tensor([[0.0, math.log(3)]]), loc, torch.full_like(loc, 0.01)
    )
    draws = ours.sample(torch.Size([20_000]))[:, 0]
    assert (draws[:, 0] * draws[:, 1] > 0).all()
    assert (draws[:, 0] > 0).float().mean().item() == pytest.approx(0.75, abs=0.015)
    assert_close(ours.mean, torch.tensor([[0.5, 0.5]]))
    assert_close(draws.var(0), ours.variance[0], rtol=0.03, atol=0)
    assert_close(ours.mode, torch.tensor([[1.0, 1.0]]), atol=1e-4, rtol=0)


def test_draws_of_a_shared_mixture_have_no_gradient_and_say_so():
    ours = SharedMixtureOfGaussians(torch.zeros(1, 2), torch.zeros(1, 2, 3), torch.ones(1, 2, 3))
    with pytest.raises(ValueError, match="rsample must not be called on a mixture over the whole"):
        ours.rsample()


def test_shared_mixture_of_one_component_is_a_gaussian():
    loc, scale = torch.randn(5000, 1, 3), torch.rand(5000, 1, 3) + 0.1
    p = SharedMixtureOfGaussians(torch.zeros(5000, 1), loc, scale)
    q = SharedMixtureOfGaussians(torch.zeros(5000, 1), loc + 0.3, 2 * scale)
    exact = [Independent(Normal(d.loc[:, 0], d.scale[:, 0]), 1) for d in (p, q)]
    assert_close(p.entropy().mean(), exact[0].entropy().mean(), rtol=0, atol=0.1)
    assert_close(kl_divergence(p, q).mean(), kl_divergence(*exact).mean(), rtol=0.03, atol=0)


def test_shared_mixture_mode_is_the_highest_point_of_a_grid():
    """Components that overlap, so that the maximum is at none of their means."""
    loc = torch.tensor([[[-0.4, 0.0], [0.4, 0.1], [0.1, -0.5]]]).double()
    scale = torch.tensor([[[0.5, 0.4], [0.4, 0.5], [0.6, 0.4]]]).double()
    ours = SharedMixtureOfGaussians(torch.tensor([[0.3, 0.0, 0.1]]).double(), loc, scale)
    axis = torch.linspace(-1.5, 1.5, 601, dtype=torch.float64)
    grid = torch.cartesian_prod(axis, axis)[:, None]
    highest = grid[ours.log_prob(grid).argmax()]
    assert (highest - loc[0]).norm(dim=-1).min() > 0.1
    assert_close(ours.mode, highest, atol=0.005, rtol=0)


def test_gradient_of_the_estimated_divergence_is_without_bias():
    """Of a Gaussian as two halves: ``KL = (mu - m)^2 / (2 s^2) + ...``, ``d / d mu = (mu - m) / s^2``."""
    mu = torch.tensor(0.3, requires_grad=True)
    loc = mu.expand(200_000, 2, 1)
    p = SharedMixtureOfGaussians(torch.zeros(200_000, 2), loc, torch.full_like(loc, 0.5))
    q = SharedMixtureOfGaussians(torch.zeros(1, 1), torch.zeros(1, 1, 1), torch.ones(1, 1, 1))
    p.kl(q).mean().backward()
    assert mu.grad.item() == pytest.approx(0.3, abs=0.01)


def test_shared_mixture_estimates_are_without_bias():
    """Far apart: ``H = H(w) + sum_k w_k H_k``."""
    logits = torch.tensor([[0.0, 1.0]]).expand(20_000, 2)
    loc = torch.tensor([[[-5.0, 0.0, 1.0], [5.0, 2.0, 0.0]]]).expand(20_000, 2, 3)
    scale = torch.tensor([[[0.1, 0.2, 0.3], [0.4, 0.1, 0.2]]]).expand(20_000, 2, 3)
    weight = logits[0].softmax(-1)
    each = Normal(loc[0], scale[0]).entropy().sum(-1)
    exact = (weight * each - weight * weight.log()).sum().item()
    estimates = SharedMixtureOfGaussians(logits, loc, scale).entropy()
    error = estimates.std().item() / 20_000**0.5
    assert estimates.mean().item() == pytest.approx(exact, abs=5 * error)


@pytest.mark.slow  # that of mixtures for each joint is quick enough
def test_compiled_it_is_the_same():
    """In one graph, without a break; traced, but not translated to C++, which takes a minute."""

    def figures(logits, loc, scale, value):
        dist = SharedMixtureOfGaussians(logits, loc, scale)
        return dist.log_prob(value), dist.mean, dist.variance, dist.mode

    args = (
        torch.randn((6, 3)),
        torch.randn((6, 3, 4)),
        torch.rand((6, 3, 4)) + 0.05,
        torch.randn(6, 4),
    )
    compiled = torch.compile(figures, backend="aot_eager", fullgraph=True)
    for value, expected in zip(compiled(*args), figures(*args), strict=True):
        assert_close(value, expected)


@pytest.mark.parametrize("times", [4, pytest.param(20, marks=pytest.mark.slow)])
def test_mode_is_the_highest_point_of_a_grid_for_hundreds_of_mixtures(times):
    """Over two joints, wide and narrow, half of them overlapping; maxima lie between the means."""
    steps = torch.linspace(0, 1, 101, dtype=torch.float64)
    grid = torch.cartesian_prod(steps, steps)[:, None]
    for _ in range(times):
        logits = torch.randn(100, 3, dtype=torch.float64)
        scale = 10 ** torch.empty(100, 3, 2, dtype=torch.float64).uniform_(-1, 0)
        near = torch.rand(100, 1, 1) < 0.5
        loc = torch.randn(100, 3, 2, dtype=torch.float64) * torch.where(near, 0.3, 1.0)
        ours = SharedMixtureOfGaussians(logits, loc, scale)
        low, high = loc.amin(1), loc.amax(1)
        best = ours.log_prob(low + (high - low) * grid).amax(0)
        assert (ours.log_prob(ours.mode) > best - 1e-4).all()
