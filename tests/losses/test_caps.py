"""Smoothness losses against closed forms of linear policies, and step by step with a memory."""

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded
from torchrl.modules import IndependentNormal, ProbabilisticActor, set_recurrent_mode

from tests.recurrent import SHAPES, live_through, lstm_actor, shake, two_grus_actor
from zfall.losses.caps import CAPSLoss
from zfall.modules.actors import gru_actor, mlp_actor

OBSERVED, JOINTS = 5, 3


class Linear(nn.Module):
    """Mean ``W o``, a standard deviation of its own."""

    def __init__(self, std: float):
        super().__init__()
        self.weight = nn.Parameter(torch.randn(JOINTS, OBSERVED))
        self.log_std = nn.Parameter(torch.full((JOINTS,), math.log(std)))

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        loc = observation @ self.weight.T
        return loc, self.log_std.exp().expand_as(loc)


def linear_actor(std: float = 0.5) -> tuple[Linear, ProbabilisticActor]:
    net = Linear(std)
    module = TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"])
    actor = ProbabilisticActor(
        module, in_keys=["loc", "scale"], distribution_class=IndependentNormal
    )
    return net, actor


def transitions(rows: int) -> TensorDict:
    return TensorDict(
        {
            "observation": torch.randn(rows, OBSERVED),
            "next": {"observation": torch.randn(rows, OBSERVED)},
        },
        [rows],
    )


def test_temporal_term_is_the_norm_of_the_change_of_a_linear_policy():
    net, actor = linear_actor()
    batch = transitions(50)
    change = (
        batch["observation"] - batch["next", "observation"]
    ).numpy() @ net.weight.T.detach().numpy()
    expected = {
        "l1": abs(change).sum(-1).mean(),
        "l2": ((change**2).sum(-1) ** 0.5).mean(),
        "squared_l2": (change**2).sum(-1).mean(),
    }
    for norm, value in expected.items():
        loss = CAPSLoss(actor, temporal_coeff=0.3, temporal_norm=norm)(batch)["loss_temporal"]
        assert loss.item() == pytest.approx(0.3 * value, rel=1e-5)


@pytest.mark.parametrize("named", [False, True])
def test_spatial_term_is_the_spread_that_a_linear_policy_makes_of_the_noise(named):
    """``E |W e|^2`` is the sum over columns of ``sigma_i^2 |W_i|^2``."""
    net, actor = linear_actor()
    spans = {"gyro": slice(0, 3), "joints": slice(3, 5)}
    sigma = {"joints": 0.4} if named else 0.4
    loss = CAPSLoss(actor, spans, spatial_coeff=2.0, sigma=sigma)(transitions(100_000))
    columns = net.weight.square().sum(0)
    expected = 2.0 * 0.16 * (columns[3:] if named else columns).sum().item()
    assert loss["loss_spatial"].item() == pytest.approx(expected, rel=0.02)


def test_sigma_is_in_deviations_of_the_observation():
    spec = Composite({"observation": Unbounded((1, OBSERVED))}, shape=(1,))
    actor = mlp_actor(spec, Unbounded((1, JOINTS)), num_cells=[8], activation="tanh")
    loss = CAPSLoss(actor, sigma=0.1)
    loss.normalizer.update(
        torch.tensor([1.0, 10.0, 0.1, 5.0, 2.0]) * torch.randn(100_000, OBSERVED)
    )
    noise = loss._neighbour(TensorDict({"observation": torch.zeros(100_000, OBSERVED)}, [100_000]))
    expected = torch.tensor([0.1, 1.0, 0.01, 0.5, 0.2])
    assert_close(noise.std(0), expected, rtol=0.03, atol=0)


def test_on_the_mean_it_leaves_the_deviation_alone_and_on_actions_not():
    """``E |W d + s (e - e')|^2 = |W d|^2 + 2 J s^2``."""
    net, actor = linear_actor(std=0.7)
    options = {"temporal_norm": "squared_l2", "temporal_coeff": 1.0, "spatial_coeff": 1.0}
    batch = transitions(200_000)
    on_mean = CAPSLoss(actor, **options)(batch)
    gradient = torch.autograd.grad(sum(on_mean.values()), net.log_std, allow_unused=True)[0]
    assert gradient is None or torch.equal(gradient, torch.zeros(JOINTS))
    on_action = CAPSLoss(actor, on_actions=True, **options)(batch)
    more = on_action["loss_temporal"] - on_mean["loss_temporal"]
    assert more.item() == pytest.approx(2 * JOINTS * 0.49, rel=0.05)
    gradient = torch.autograd.grad(on_action["loss_temporal"], net.log_std)[0]
    assert_close(gradient, torch.full((JOINTS,), 4 * 0.49), rtol=0.1, atol=0)


def sequences(actor: ProbabilisticActor, num: int, steps: int) -> TensorDict:
    """What a recurrent policy collects, with resets in between."""
    hidden = torch.zeros(num, 2, 8)
    rows, init = [], torch.ones(num, 1, dtype=torch.bool)
    for _ in range(steps):
        td = TensorDict({"observation": torch.randn(num, OBSERVED), "is_init": init}, [num])
        td["recurrent_state_actor"] = torch.where(init[:, None], 0.0, hidden)
        with torch.no_grad():
            after = actor(td.clone())
        td["mean"] = actor.get_dist(td.clone()).mean.detach()
        hidden, init = after["next", "recurrent_state_actor"], torch.rand(num, 1) < 0.3
        rows.append(td)
    return torch.stack(rows, 1)


@pytest.fixture
def recurrent() -> tuple[ProbabilisticActor, TensorDict]:
    spec = Composite({"observation": Unbounded((1, OBSERVED))}, shape=(1,))
    actor = gru_actor(spec, Unbounded((1, JOINTS)), hidden_size=8, num_layers=2, components=2)
    for parameter in actor.parameters():
        nn.init.normal_(parameter, std=0.5)
    return actor, sequences(actor, 6, 12)


def test_pairs_of_a_recurrent_policy_follow_the_sequence_but_not_across_episodes(recurrent):
    actor, batch = recurrent
    loss = CAPSLoss(actor, temporal_coeff=1.0)(batch.exclude("mean"))
    changes = [
        (batch["mean"][n, t + 1] - batch["mean"][n, t]).abs().sum()
        for n in range(6) for t in range(11) if not batch["is_init"][n, t + 1]
    ]  # fmt: skip
    assert 20 < len(changes) < 60
    assert_close(loss["loss_temporal"], torch.stack(changes).mean(), rtol=1e-4, atol=0)


def test_both_of_a_spatial_pair_of_a_recurrent_policy_have_the_same_memory(recurrent, monkeypatch):
    actor, batch = recurrent
    caps = CAPSLoss(actor, spatial_coeff=1.0)
    monkeypatch.setattr(caps, "_neighbour", lambda steps: steps["observation"] + 0.3)
    loss = caps(batch.exclude("mean"))["loss_spatial"]
    moved = []
    for n in range(6):
        for t in range(12):
            step = batch[n : n + 1, t].exclude("mean").clone()
            step["observation"] = step["observation"] + 0.3
            moved.append((actor.get_dist(step).mean[0] - batch["mean"][n, t]).square().sum())
    assert_close(loss, torch.stack(moved).mean(), rtol=1e-4, atol=0)


def test_companions_in_one_pass_with_the_batch_are_what_it_finds_by_itself(recurrent, monkeypatch):
    actor, batch = recurrent
    batch = batch.exclude("mean")
    caps = CAPSLoss(actor, spatial_coeff=1.0)
    monkeypatch.setattr(caps, "_neighbour", lambda steps: steps["observation"] + 0.3)
    expected = caps(batch.copy())
    near = caps.companions(batch)
    own = batch.select(*actor.in_keys).set("memory_of", torch.full(batch.shape, -1))
    with set_recurrent_mode(True):
        means = actor.get_dist(torch.cat([own, near])).mean
    batch["deterministic_action"], batch["neighbour_action"] = means.chunk(2)
    monkeypatch.setattr(caps, "_act", None)  # it need not ask any more
    assert expected["loss_spatial"] > 1e-3
    assert_close(caps(batch), expected, rtol=1e-4, atol=1e-7)


def test_the_gradient_of_a_recurrent_policy_goes_through_the_memory_of_all(recurrent, monkeypatch):
    """Central differences of both terms in float64, along a random direction of all weights.

    Beside a memory that was taken for a constant the gradient would be another one.
    """
    actor, batch = recurrent
    actor.double()
    batch = batch.exclude("mean").apply(lambda x: x.double() if x.is_floating_point() else x)
    caps = CAPSLoss(actor, temporal_norm="squared_l2", temporal_coeff=1.0, spatial_coeff=1.0)
    near = batch["observation"] + torch.randn_like(batch["observation"])
    monkeypatch.setattr(caps, "_neighbour", lambda steps: near)
    weights = list(actor.parameters())
    way = [torch.randn_like(weight) for weight in weights]

    def moved(step: float) -> dict[str, float]:
        with torch.no_grad():
            for weight, along in zip(weights, way, strict=True):
                weight.add_(along, alpha=step)
            values = {key: value.item() for key, value in caps(batch).items()}
            for weight, along in zip(weights, way, strict=True):
                weight.sub_(along, alpha=step)
        return values

    slopes = {}
    for key, loss in caps(batch).items():
        gradient = torch.autograd.grad(loss, weights, retain_graph=True, allow_unused=True)
        pairs = zip(gradient, way, strict=True)
        slopes[key] = sum((g * along).sum().item() for g, along in pairs if g is not None)
    after, before = moved(1e-6), moved(-1e-6)
    for key, slope in slopes.items():
        assert slope == pytest.approx((after[key] - before[key]) / 2e-6, rel=1e-5)


def lstm_by_hand(actor: ProbabilisticActor, batch: TensorDict, near: torch.Tensor):
    """Means of a sequence and of neighbours, by the definition of an LSTM, row by row::

    i, f, g, o = W x + b + U h + c,  c' = s(f) c + s(i) tanh(g),  h' = s(o) tanh(c')
    """
    encoder, cell = actor[0][0][0].module, actor[0][0][1].lstm
    weights, head = cell.all_weights[0], actor[0][1].module

    def step(observation, h, c):
        gates = encoder(observation) @ weights[0].T + weights[2] + h @ weights[1].T + weights[3]
        i, f, g, o = gates.chunk(4)
        c = f.sigmoid() * c + i.sigmoid() * g.tanh()
        h = o.sigmoid() * c.tanh()
        return head(h)[0], h, c

    means, nears = [], []
    for n in range(batch.shape[0]):
        h, c = (batch[f"recurrent_state_actor_{name}"][n, 0, 0] for name in "hc")
        for t in range(batch.shape[1]):
            if batch["is_init"][n, t]:
                h, c = torch.zeros_like(h), torch.zeros_like(c)
            nears.append(step(near[n, t], h, c)[0])
            mean, h, c = step(batch["observation"][n, t], h, c)
            means.append(mean)
    return (torch.stack(x).view(*batch.shape, -1) for x in (means, nears))


@pytest.mark.parametrize("begun", [False, True])
def test_both_terms_and_gradients_of_an_lstm_are_those_of_one_unrolled_by_hand(begun, monkeypatch):
    """Of TorchRL's module, that in a sequence writes the last memory alone; begun in the midst."""
    spec = Composite({"observation": Unbounded((1, OBSERVED))}, shape=(1,))
    actor = shake(lstm_actor(spec, Unbounded((1, JOINTS)))).double()
    batch = TensorDict(
        {
            "observation": torch.randn(5, 9, OBSERVED).double(),
            "is_init": torch.rand(5, 9, 1) < 0.25,
        },
        [5, 9],
    )
    batch = live_through(actor, batch, SHAPES["lstm"])[:, 3 * begun :]
    assert batch["is_init"][:, 1:].any()
    near = batch["observation"] + 0.5 * torch.randn_like(batch["observation"])
    caps = CAPSLoss(actor, temporal_coeff=1.0, spatial_coeff=1.0)
    monkeypatch.setattr(caps, "_neighbour", lambda steps: near)
    ours = caps(batch)
    means, nears = lstm_by_hand(actor, batch, near)
    follows = ~batch["is_init"][:, 1:, 0]
    theirs = {
        "loss_temporal": (means[:, 1:] - means[:, :-1]).abs().sum(-1)[follows].mean(),
        "loss_spatial": (means - nears).square().sum(-1).mean(),
    }
    weights = list(actor.parameters())
    for key, expected in theirs.items():
        assert expected > 1e-3
        assert_close(ours[key], expected)
        found, right = (
            torch.autograd.grad(value, weights, retain_graph=True, allow_unused=True)
            for value in (ours[key], expected)
        )
        assert_close([g for g in found if g is not None], [g for g in right if g is not None])


def test_spatial_pairs_of_two_memories_have_what_each_had_there(monkeypatch):
    """Two GRUs in a row, neighbours asked step by step from the memories that were lived through."""
    spec = Composite({"observation": Unbounded((1, OBSERVED))}, shape=(1,))
    actor = shake(two_grus_actor(spec, Unbounded((1, JOINTS))))
    begins = torch.rand(6, 12, 1) < 0.2
    batch = TensorDict({"observation": torch.randn(6, 12, OBSERVED), "is_init": begins}, [6, 12])
    batch = live_through(actor, batch, SHAPES["two grus"])
    caps = CAPSLoss(actor, spatial_coeff=1.0)
    monkeypatch.setattr(caps, "_neighbour", lambda steps: steps["observation"] + 0.3)
    assert caps.companions(batch) is None
    found = caps(batch[:, 4:])["loss_spatial"]
    steps = batch[:, 4:].reshape(-1)
    moved = steps.clone().set("observation", steps["observation"] + 0.3)
    with torch.no_grad():
        here, there = (actor.get_dist(td.clone()).mean for td in (steps, moved))
    assert_close(found, (here - there).square().sum(-1).mean(), rtol=1e-4, atol=1e-7)


def test_a_smooth_policy_costs_nothing_and_has_a_finite_gradient():
    net, actor = linear_actor()
    nn.init.zeros_(net.weight)
    for norm in ("l1", "l2", "squared_l2"):
        loss = CAPSLoss(actor, temporal_norm=norm, spatial_norm=norm)(transitions(10))
        assert sum(loss.values()).item() < 1e-5
        gradient = torch.autograd.grad(sum(loss.values()), net.weight)[0]
        assert gradient.isfinite().all()


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ({"spatial_coeff": math.nan}, r"spatial_coeff must be finite and not negative, got nan"),
        ({"temporal_coeff": -1.0}, r"temporal_coeff must be finite and not negative, got -1.0"),
        ({"sigma": -0.1}, r"sigma must be finite and not negative, got -0.1"),
        ({"sigma": {"nose": 0.1}}, r"sigma must name quantities of the observation \(gyro\)"),
        ({"spatial_norm": "l3"}, r"spatial_norm must be one of l1, l2, squared_l2, got 'l3'"),
    ],
)
def test_bad_values_are_refused(values, rule):
    with pytest.raises(ValueError, match=rule):
        CAPSLoss(linear_actor()[1], {"gyro": slice(0, 3)}, **values)


@pytest.mark.parametrize("shared", [False, True])
def test_actions_of_a_mixture_are_refused(shared):
    spec = Composite({"observation": Unbounded((1, OBSERVED))}, shape=(1,))
    actor = mlp_actor(spec, Unbounded((1, JOINTS)), components=2, shared_components=shared)
    with pytest.raises(ValueError, match="on_actions must be false for a mixture, whose draws"):
        CAPSLoss(actor, on_actions=True)


@pytest.mark.parametrize("recurrent", [False, True])
def test_neighbours_of_the_batch_are_taken_in_place_of_drawn_ones(recurrent):
    """Neighbours at the observation itself cost nothing, however large sigma is."""
    spec = Composite({"observation": Unbounded((1, OBSERVED))}, shape=(1,))
    build = gru_actor if recurrent else mlp_actor
    actor = build(spec, Unbounded((1, JOINTS)))
    batch = transitions(12)
    batch["near"] = batch["observation"].clone()
    if recurrent:
        batch["is_init"] = torch.zeros(12, 1, dtype=torch.bool)
        batch["recurrent_state_actor"] = torch.zeros(12, 3, 64)
        batch = batch.reshape(3, 4)
    assert CAPSLoss(actor, sigma=9.0, neighbour_key="near")(batch)["loss_spatial"] < 1e-9
    batch["near"] = batch["near"] + 1.0
    assert CAPSLoss(actor, sigma=0.0, neighbour_key="near")(batch)["loss_spatial"] > 1e-9


@pytest.mark.parametrize("memory", [False, True])
def test_without_a_spatial_weight_no_neighbour_is_drawn_or_asked(memory, recurrent, monkeypatch):
    actor, batch = recurrent if memory else (linear_actor()[1], transitions(12))
    batch = batch.exclude("mean")
    expected = CAPSLoss(actor, spatial_coeff=0.1)(batch.copy())["loss_temporal"]
    caps = CAPSLoss(actor, spatial_coeff=0.0, neighbour_key="near")  # which the batch has not
    asked = []
    act = caps._act
    monkeypatch.setattr(caps, "_act", lambda seen: asked.append(seen) or act(seen))
    drawn = torch.get_rng_state()
    losses = caps(batch.copy())
    assert torch.equal(drawn, torch.get_rng_state())
    assert_close(losses["loss_temporal"], expected)
    assert losses["loss_spatial"] == 0
    assert "near" not in caps.in_keys
    assert caps.companions(batch) is None
    # A batch of both ends of the pairs, or the sequences once.
    assert [seen.numel() for seen in asked] == [72 if memory else 24]
