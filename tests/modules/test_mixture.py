"""The mixtures against torch's, SciPy's, brute force and closed forms."""

import math

import pytest
import torch
from scipy.stats import norm
from tensordict import TensorDict
from torch.distributions import Categorical, Independent, MixtureSameFamily, Normal, kl_divergence
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type

from zfall.modules.actors import mlp_actor
from zfall.modules.mixture import MixtureOfGaussians

Parameters = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


def draw(*shape: int) -> Parameters:
    """Logits, means and deviations: wide and narrow, far apart and on top of each other.

    Of a third of them the logits differ by tens.
    """
    scale = 10 ** torch.empty(shape, dtype=torch.float64).uniform_(-2, 0)  # 0.01 to 1
    loc = torch.randn(shape, dtype=torch.float64)
    near = torch.rand(*shape[:-1], 1) < 0.3
    loc = torch.where(near, loc[..., :1] + 0.01 * loc, loc)
    sure = torch.rand(*shape[:-1], 1) < 0.33
    logits = torch.randn(shape, dtype=torch.float64)
    return torch.where(sure, 15 * logits, 2 * logits), loc, scale


@pytest.fixture
def parameters() -> Parameters:
    return draw(50, 4, 3)


def reference(logits, loc, scale) -> MixtureSameFamily:
    """Of each joint."""
    return MixtureSameFamily(Categorical(logits=logits), Normal(loc, scale))


def brute_force(parameters: Parameters):
    """Density, its log and step of a grid far finer than any component."""
    logits, loc, scale = parameters
    low, high = (loc - 9 * scale).amin(-1), (loc + 9 * scale).amax(-1)
    grid = low + (high - low) * torch.linspace(0, 1, 8_001, dtype=torch.float64)[:, None]
    density = torch.zeros_like(grid)
    for k in range(loc.shape[-1]):
        weight = logits.softmax(-1)[..., k]
        z = (grid - loc[..., k]) / scale[..., k]
        density += weight * torch.exp(-0.5 * z * z) / (scale[..., k] * math.sqrt(2 * math.pi))
    return grid, density, density.clamp_min(1e-300).log(), (high - low) / 8_000


def divergence(parameters: Parameters, others: Parameters) -> torch.Tensor:
    """``sum_k w_k E_k[log p - log q]``, each by sums over a grid that is fine for component k."""
    logits, loc, scale = parameters
    z = torch.linspace(-9, 9, 8_001, dtype=torch.float64)[:, None]
    density = torch.exp(-0.5 * z * z) / math.sqrt(2 * math.pi) * 18 / 8_000
    p, q, out = reference(*parameters), reference(*others), torch.zeros(())
    for k in range(loc.shape[-1]):
        x = loc[..., k] + z * scale[..., k]
        out = out + logits.softmax(-1)[..., k] * (density * (p.log_prob(x) - q.log_prob(x))).sum(0)
    return out


def test_density_distribution_mean_and_variance_are_those_of_torch(parameters):
    ours, theirs = MixtureOfGaussians(*parameters), reference(*parameters)
    value = torch.randn(50, 4, dtype=torch.float64)
    joint = Independent(theirs, 1)
    assert_close(ours.log_prob(value), joint.log_prob(value), atol=1e-6, rtol=1e-9)
    assert_close(ours.cdf(value), theirs.cdf(value), atol=1e-12, rtol=1e-9)
    assert_close(ours.mean, theirs.mean)
    assert_close(ours.variance, theirs.variance)


def test_density_and_distribution_are_those_of_scipy(parameters):
    weight, loc, scale = (p.numpy() for p in (parameters[0].softmax(-1), *parameters[1:]))
    value = torch.randn(50, 4, dtype=torch.float64)
    at = value.numpy()[..., None]
    ours = MixtureOfGaussians(*parameters)
    density = (weight * norm.pdf(at, loc, scale)).sum(-1)
    assert_close(ours.joint_log_prob(value).exp(), torch.from_numpy(density))
    assert_close(ours.cdf(value), torch.from_numpy((weight * norm.cdf(at, loc, scale)).sum(-1)))


def test_single_precision_neither_overflows_nor_loses_the_density():
    shape = (2000, 4, 3)
    logits = 30.0 * torch.randint(-1, 2, shape)
    loc, scale = torch.randn(shape), torch.full(shape, 0.01)
    for value in (loc[..., 0] + 0.01 * torch.randn(2000, 4), torch.full((2000, 4), 50.0)):
        ours = MixtureOfGaussians(logits, loc, scale).log_prob(value)
        exact = MixtureOfGaussians(*(p.double() for p in (logits, loc, scale))).log_prob(
            value.double()
        )
        assert ours.isfinite().all()
        assert_close(ours.double(), exact, rtol=1e-4, atol=1e-4)


def test_draws_have_the_mean_and_variance(parameters):
    ours = MixtureOfGaussians(*(p[:2] for p in parameters))
    draws = ours.sample(torch.Size([200_000]))
    sigma = ours.variance.sqrt()
    assert ((draws.mean(0) - ours.mean).abs() < 5 * sigma / 200_000**0.5).all()
    assert_close(draws.var(0), ours.variance, rtol=0.03, atol=1e-4)


@pytest.mark.parametrize("share", [0.0, 1.0 - 2.0**-24])
def test_a_component_without_weight_is_never_drawn(monkeypatch, share):
    """Not even by the smallest and the largest share that a generator of float32 gives."""
    monkeypatch.setattr(torch.Tensor, "uniform_", lambda out: out.fill_(share))
    logits = torch.tensor([[[-200.0, 0.3, 0.1, 0.2, -200.0]]])
    loc = torch.tensor([[[-1e6, 0.0, 0.0, 0.0, 1e6]]])
    for scale in (0.3, 1.7, 2.9):  # of the logits, for other roundings of their sum
        draw = MixtureOfGaussians(scale * logits, loc, torch.ones(1, 1, 5)).sample()
        assert draw.abs() < 10


@pytest.mark.parametrize("spread", [None, 0.01])
def test_draws_carry_the_gradient_by_means_and_deviations(spread):
    """``d E[x^2] = d (sum_k w_k (mu_k^2 + sigma_k^2))``, by draws and in closed form.

    However far components lie apart, no draw moves by more than the components do.
    """
    logits, *values = draw(1, 1, 3)
    if spread is not None:
        values = [torch.tensor([[[-1.0, 0.0, 1.0]]]).double(), torch.full_like(values[1], spread)]
    values = [p.requires_grad_() for p in values]
    moment = (logits.softmax(-1) * (values[0].square() + values[1].square())).sum()
    exact = torch.autograd.grad(moment, values)
    many = [p.expand(400_000, 1, 3).detach().requires_grad_() for p in values]
    drawn = MixtureOfGaussians(logits.expand(400_000, 1, 3), *many).rsample()
    found = torch.autograd.grad(drawn.square().sum(), many, retain_graph=True)
    for got, expected in zip(found, exact, strict=True):
        assert_close(got.mean(0), expected[0], rtol=0.05, atol=0.02)
    by_means = torch.autograd.grad(drawn.sum(), many[0])[0]
    assert by_means.min() > -1e-6
    assert_close(by_means.sum(-1), torch.ones_like(by_means[..., 0]))


def test_draws_have_no_gradient_by_the_weights_and_say_so():
    """The only estimate that follows a draw gave 0.024 for 0.25, from a million draws."""
    logits = torch.zeros(1, 1, 2, requires_grad=True)
    mixture = MixtureOfGaussians(logits, torch.tensor([[[-0.5, 0.5]]]), torch.full((1, 1, 2), 0.01))
    assert not mixture.has_rsample
    with pytest.raises(ValueError, match="logits must not require a gradient for rsample"):
        mixture.rsample()
    with torch.no_grad():
        assert mixture.rsample().shape == (1, 1)


def test_an_actor_draws_where_gradients_are_enabled():
    spec = Composite(observation=Unbounded((1, 4)), shape=(1,))
    actor = mlp_actor(spec, Unbounded((1, 2)), num_cells=[8], components=2)
    seen = TensorDict({"observation": torch.randn(3, 4)}, [3])
    with set_exploration_type(ExplorationType.RANDOM):
        out = actor(seen)
    assert not out["action"].requires_grad
    assert out["action_log_prob"].requires_grad


@pytest.mark.parametrize("times", [2, pytest.param(20, marks=pytest.mark.slow)])
def test_mode_is_the_highest_point_of_a_grid_for_thousands_of_mixtures(times):
    for parameters in (draw(500, 3) for _ in range(times)):
        _, density, _, _ = brute_force(parameters)
        ours = MixtureOfGaussians(*(p[:, None] for p in parameters))
        best = ours.joint_log_prob(ours.mode)[:, 0]
        assert (best >= density.amax(0).log() - 1e-6).all()


def test_mode_of_components_on_top_of_each_other():
    """Two of three the same, two maxima of nearly equal height: the grid's is not exceeded."""
    logits = torch.log(torch.tensor([[[0.25, 0.25, 0.499]], [[0.25, 0.25, 0.501]]])).double()
    loc = torch.tensor([[[-1.0, -1.0, 1.0]]]).double().expand(2, 1, 3)
    ours = MixtureOfGaussians(logits, loc, torch.full((2, 1, 3), 0.1).double())
    assert_close(ours.mode, torch.tensor([[-1.0], [1.0]]).double(), atol=1e-6, rtol=0)


def test_mode_moves_with_the_parameters_as_finite_differences_say():
    logits = torch.tensor([[[0.3, 0.0]]], dtype=torch.float64)
    loc = torch.tensor([[[0.2, -0.3]]], dtype=torch.float64)
    scale = torch.tensor([[[0.4, 0.5]]], dtype=torch.float64)
    values = [p.requires_grad_() for p in (logits, loc, scale)]
    gradient = torch.autograd.grad(MixtureOfGaussians(*values).mode.sum(), values)
    for which, got in enumerate(gradient):
        for component in range(2):
            ends = []
            for step in (1e-4, -1e-4):
                moved = [p.detach().clone() for p in values]
                moved[which][0, 0, component] += step
                ends.append(MixtureOfGaussians(*moved).mode.item())
            assert got[0, 0, component].item() == pytest.approx(
                (ends[0] - ends[1]) / 2e-4, abs=1e-3
            )


@pytest.mark.parametrize("times", [2, pytest.param(20, marks=pytest.mark.slow)])
def test_entropy_is_that_of_brute_force_for_thousands_of_mixtures(times):
    for parameters in (draw(500, 3) for _ in range(times)):
        _, density, log, step = brute_force(parameters)
        exact = -(density * log).sum(0) * step
        for kind, bound in ((torch.float64, 2e-5), (torch.float32, 1e-3)):
            ours = MixtureOfGaussians(*(p[:, None].to(kind) for p in parameters)).entropy()
            assert (ours - exact).abs().max() < bound


@pytest.mark.parametrize("pairs", [500, pytest.param(10_000, marks=pytest.mark.slow)])
def test_divergence_is_that_of_brute_force(pairs):
    """Also of narrow ones far apart, of which it is thousands."""
    largest = 0.0
    for parameters, others in ((draw(500, 3), draw(500, 3)) for _ in range(pairs // 500)):
        exact = divergence(parameters, others)
        largest = max(largest, exact.max().item())
        for kind, share in ((torch.float64, 0.0), (torch.float32, 1e-4)):
            p, q = (
                MixtureOfGaussians(*(x[:, None].to(kind) for x in x)) for x in (parameters, others)
            )
            assert_close(kl_divergence(p, q).double(), exact, atol=1e-3, rtol=share)
    assert largest > 1000


def test_entropy_and_divergence_of_one_component_are_the_closed_forms():
    zero, one = torch.zeros(1, 2, 1), torch.ones(1, 2, 1)
    p, q = MixtureOfGaussians(zero, zero, 0.1 * one), MixtureOfGaussians(zero, one, 0.5 * one)
    assert p.entropy().item() == pytest.approx(
        2 * (0.5 + 0.5 * math.log(2 * math.pi) + math.log(0.1)), abs=1e-4
    )
    expected = 2 * (math.log(5) + (0.01 + 1) / (2 * 0.25) - 0.5)
    assert kl_divergence(p, q).item() == pytest.approx(expected, abs=1e-4)
    assert kl_divergence(p, p).item() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("what", ["log_prob", "entropy", "kl", "cdf"])
def test_gradients_are_those_of_finite_differences(what):
    value, other = torch.randn(3, 2).double(), draw(3, 2, 3)

    def evaluate(*parameters: torch.Tensor) -> torch.Tensor:
        mixture = MixtureOfGaussians(*parameters)
        if what == "kl":
            return mixture.kl(MixtureOfGaussians(other[0], other[1], other[2] + 0.2))
        return mixture.entropy() if what == "entropy" else getattr(mixture, what)(value)

    logits, loc, scale = (p.requires_grad_() for p in draw(3, 2, 3))
    assert torch.autograd.gradcheck(evaluate, (logits, loc, scale), eps=1e-6, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("shared_components", [False, True])
@pytest.mark.parametrize("statistic", ["mean", "mode"])
def test_policy_without_exploration_gives_the_chosen_statistic(shared_components, statistic):
    spec = Composite({"observation": Unbounded((2, 6))}, shape=(2,))
    actor = mlp_actor(
        spec,
        Unbounded((2, 4)),
        components=3,
        shared_components=shared_components,
        statistic=statistic,
    )
    td = spec.rand()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        action = actor(td.clone())["action"]
    assert_close(action, getattr(actor.get_dist(td), statistic))


def test_compiled_it_is_the_same():
    """In one graph, without a break; traced, but not translated to C++, which takes a minute."""

    def figures(logits, loc, scale, value):
        dist = MixtureOfGaussians(logits, loc, scale)
        return (
            dist.log_prob(value),
            dist.mean,
            dist.variance,
            dist.mode,
            dist.entropy(),
            dist.cdf(value),
            dist.kl(dist),
        )

    args = (
        torch.randn((6, 4, 3)),
        torch.randn((6, 4, 3)),
        torch.rand((6, 4, 3)) + 0.05,
        torch.randn(6, 4),
    )
    compiled = torch.compile(figures, backend="aot_eager", fullgraph=True)
    for value, expected in zip(compiled(*args), figures(*args), strict=True):
        assert_close(value, expected)
