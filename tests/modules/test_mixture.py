"""The mixture against torch's and SciPy's."""

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.stats import norm
from torch.distributions import Categorical, Independent, MixtureSameFamily, Normal
from torch.testing import assert_close

from zfall.modules.mixture import MixtureOfGaussians


@pytest.fixture
def parameters() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    shape = (50, 4, 3)
    scale = torch.empty(shape, dtype=torch.float64).uniform_(0.01, 1.0)
    return torch.randn(shape, dtype=torch.float64), torch.randn(shape, dtype=torch.float64), scale


def reference(logits, loc, scale) -> Independent:
    return Independent(MixtureSameFamily(Categorical(logits=logits), Normal(loc, scale)), 1)


def test_log_prob_mean_and_variance_agree_with_torch(parameters):
    ours, theirs = MixtureOfGaussians(*parameters), reference(*parameters)
    value = torch.randn(50, 4, dtype=torch.float64)
    assert_close(ours.log_prob(value), theirs.log_prob(value), atol=1e-6, rtol=1e-9)
    assert_close(ours.mean, theirs.mean)
    assert_close(ours.variance, theirs.variance)


def test_samples_have_the_mean_and_variance(parameters):
    ours = MixtureOfGaussians(*(p[:2] for p in parameters))
    draws = ours.sample(torch.Size([200_000]))
    sigma = ours.variance.sqrt()
    assert ((draws.mean(0) - ours.mean).abs() < 5 * sigma / 200_000**0.5).all()
    assert_close(draws.var(0).double(), ours.variance, rtol=0.02, atol=1e-4)


def test_mode_is_the_highest_point_of_a_grid(parameters):
    ours = MixtureOfGaussians(*parameters)
    grid = torch.linspace(-5, 5, 20001, dtype=torch.float64)[:, None, None].expand(-1, 50, 4)
    logits, loc, scale = parameters
    each = MixtureSameFamily(Categorical(logits=logits), Normal(loc, scale))
    density, best = each.log_prob(grid), each.log_prob(ours.mode)
    assert (best >= density.amax(0) - 1e-4).all()


def test_entropy_is_without_bias(parameters):
    """Mean of many estimates against SciPy's quadrature, for one joint."""
    logits, loc, scale = (p[0, 0] for p in parameters)
    weight = logits.softmax(-1).numpy()

    def density(x: float) -> float:
        return float((weight * norm.pdf(x, loc.numpy(), scale.numpy())).sum())

    points = sorted(loc.tolist())
    exact = quad(
        lambda x: -density(x) * np.log(density(x) + 1e-300), -8, 8, points=points, limit=500
    )[0]
    expanded = [p.expand(40_000, 1, 3) for p in (logits, loc, scale)]
    estimates = MixtureOfGaussians(*expanded).entropy()
    error = estimates.std().item() / 40_000**0.5
    assert estimates.mean().item() == pytest.approx(exact, abs=5 * error)


def test_entropy_has_a_gradient_in_the_deviation():
    """For one component H = log(sigma) + const, so dH / dsigma = 1 / sigma."""
    scale = torch.full((4000, 1, 1), 0.4, requires_grad=True)
    MixtureOfGaussians(
        torch.zeros(4000, 1, 1), torch.zeros(4000, 1, 1), scale
    ).entropy().sum().backward()
    assert scale.grad.mean().item() == pytest.approx(1 / 0.4, rel=0.1)
