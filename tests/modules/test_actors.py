"""Actors and critics: shapes, sizes, and recurrence that replays."""

import math
from itertools import pairwise

import pytest
import torch
from hydra.utils import instantiate
from tensordict import TensorDict
from torch.nn.functional import elu
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type
from torchrl.modules import set_recurrent_mode

from zfall.modules.actors import gru_actor, mlp_actor, mlp_trunk, normalizer_of
from zfall.modules.critics import gru_critic
from zfall.modules.gru import StackedGRU


def specs(size: int = 50, critic: int = 484) -> tuple[Composite, Unbounded]:
    shapes = {"observation": Unbounded((2, size)), "observation_critic": Unbounded((2, critic))}
    return Composite(shapes, shape=(2,)), Unbounded((2, 20))


def count(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def test_zeroth_fall_networks_have_the_published_number_of_parameters():
    """195 061 as published, plus two redundant bias vectors of 64 in each of six cells of torch."""
    spec, action_spec = specs()
    actor, critic = gru_actor(spec, action_spec), gru_critic(spec)
    assert count(actor) == 89_460 + 3 * 128
    assert count(critic) == 105_601 + 3 * 128
    assert count(actor) + count(critic) == 195_061 + 768 == 195_829


def test_zeroth_fall_networks_of_the_yaml_have_the_numbers_counted_by_hand(compose_config):
    """A cell of torch has 3 gates, each with weights H x (H + H) and two bias vectors of H."""
    spec, action_spec = specs()
    for name, critic_name, size, layers, components, published in [
        ("zf", "gru", 64, 3, 3, 195_829),
        ("zf_original", "zf_original", 128, 5, 5, 1_098_157),
    ]:
        cfg = compose_config(f"actor={name}", f"critic={critic_name}")
        actor = instantiate(cfg.actor, spec, action_spec)
        critic = instantiate(cfg.critic, spec)
        cells = layers * 3 * (size * (size + size) + 2 * size)
        outputs = 20 * 3 * components
        assert count(actor) == (50 + 1) * size + cells + (size + 1) * outputs
        assert count(critic) == (484 + 1) * size + cells + (size + 1)
        assert count(actor) + count(critic) == published


@pytest.mark.parametrize(("name", "cells"), [("icub", (512, 128)), ("atalante", (64, 64))])
def test_feed_forward_networks_of_the_papers_have_their_sizes(compose_config, name, cells):
    """Weights and biases of two hidden layers, 20 means, and 20 deviations if they are learned."""
    spec, action_spec = specs(56, 60)
    cfg = compose_config(f"actor={name}", f"critic={name}")
    actor, critic = instantiate(cfg.actor, spec, action_spec), instantiate(cfg.critic, spec)
    first, second = cells
    learned = 20 if name == "icub" else 0
    hidden = (first + 1) * second
    assert count(actor) == (56 + 1) * first + hidden + (second + 1) * 20 + learned
    assert count(critic) == (60 + 1) * first + hidden + (second + 1)


@pytest.mark.parametrize(
    ("name", "function"), [("relu", torch.relu), ("tanh", torch.tanh), ("elu", elu)]
)
def test_trunk_is_layers_with_the_activation_asked(name, function):
    trunk, x = mlp_trunk(4, [5, 3], name), torch.randn(7, 4)
    expected = x
    for layer in (trunk[0], trunk[2]):
        expected = function(expected @ layer.weight.T + layer.bias)
    assert_close(trunk(x), expected)


def test_fixed_deviation_is_no_parameter_and_has_no_lower_bound():
    spec, action_spec = specs()
    actor = mlp_actor(spec, action_spec, std=0.01, learn_std=False)
    assert not [name for name, _ in actor.named_parameters() if "std" in name]
    dist = actor.get_dist(TensorDict({"observation": torch.randn(2, 50)}, batch_size=[2]))
    assert_close(dist.variance.sqrt(), torch.full((2, 20), 0.01))


@pytest.mark.parametrize("build", [mlp_actor, gru_actor])
def test_without_a_normaliser_the_observation_goes_in_as_it_is(build):
    """An observation far beyond where a normaliser clips tells itself from one still farther."""
    spec, action_spec = specs()
    for normalize, differs in ((True, False), (False, True)):
        actor = build(spec, action_spec, normalize=normalize)
        assert (normalizer_of(actor) is None) == differs
        means = []
        for size in (20.0, 30.0):
            td = TensorDict({"observation": torch.full((2, 50), size), "is_init": torch.ones(2, 1).bool(),
                             "recurrent_state_actor": torch.zeros(2, 3, 64)}, batch_size=[2])  # fmt: skip
            means.append(actor.get_dist(td).mean)
        assert torch.equal(*means) != differs


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"activation": "gelu"}, "activation must be one of elu, relu, tanh, got 'gelu'"),
        ({"components": 3, "learn_std": False}, "learn_std must be true with components, got 3"),
        ({"statistic": "median"}, "statistic must be mean or mode, got 'median'"),
        ({"initialization": "zeros"}, "initialization must be orthogonal or default, got 'zeros'"),
        ({"state_std": True, "learn_std": False}, "learn_std must be true with state_std"),
        ({"shared_components": True}, "shared_components needs components"),
        ({"std_range": [0.3, 0.1]}, r"std_range must be \[floor, cap\]"),
        ({"std": 0.1, "std_range": [0.2, 0.5]}, "std must lie above the floor 0.2"),
        ({"std": 1.2, "components": 2}, "not over 1.0, got 1.2"),
        ({"std": 0.0, "learn_std": False}, "std must be positive, got 0"),
        ({"components": -1}, "components must not be negative, got -1"),
        ({"spread": 0.1}, "spread needs components, got 0 of them"),
        ({"spread": -0.1, "components": 3}, "spread must not be negative, got -0.1"),
        ({"num_cells": []}, r"num_cells must be widths of at least 1, one or more, got \[\]"),
        ({"num_cells": [8, 0]}, r"num_cells must be widths of at least 1.*got \[8, 0\]"),
    ],
)
def test_values_that_no_actor_has_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        mlp_actor(*specs(), **values)


@pytest.mark.parametrize("name", ["hidden_size", "num_layers"])
def test_a_memory_without_size_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be at least 1, got 0"):
        gru_actor(*specs(), **{name: 0})


@pytest.mark.parametrize("build", [mlp_actor, gru_actor])
@pytest.mark.parametrize("components", [0, 1, 3])
def test_actor_gives_actions_and_their_log_probability(build, components):
    spec, action_spec = specs()
    actor = build(spec, action_spec, components=components)
    td = TensorDict({"observation": torch.randn(2, 50), "is_init": torch.ones(2, 1).bool(),
                     "recurrent_state_actor": torch.zeros(2, 3, 64)}, batch_size=[2])  # fmt: skip
    out = actor(td.clone())
    assert out["action"].shape == (2, 20)
    assert_close(actor.get_dist(td).log_prob(out["action"]), out["action_log_prob"])


@pytest.mark.parametrize("build", [mlp_actor, gru_actor])
@pytest.mark.parametrize("components", [0, 3])
def test_without_exploration_the_action_is_the_mean(build, components):
    spec, action_spec = specs()
    actor = build(spec, action_spec, components=components)
    td = TensorDict({"observation": torch.randn(2, 50), "is_init": torch.ones(2, 1).bool(),
                     "recurrent_state_actor": torch.zeros(2, 3, 64)}, batch_size=[2])  # fmt: skip
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert_close(actor(td.clone())["action"], actor.get_dist(td).mean)


@pytest.mark.parametrize("std", [0.2, 0.6])
@pytest.mark.parametrize("components", [0, 1])
def test_actor_begins_with_the_deviation_asked(components, std):
    spec, action_spec = specs()
    actor = mlp_actor(spec, action_spec, components=components, std=std)
    dist = actor.get_dist(TensorDict({"observation": torch.zeros(2, 50)}, batch_size=[2]))
    assert_close(dist.variance.sqrt(), torch.full((2, 20), std), rtol=1e-3, atol=0)


@pytest.mark.parametrize("build", [gru_actor, gru_critic])
def test_gates_begin_orthogonal_if_asked(build):
    """Of a square block W W' = 1, of one of 64 x 50 W' W = 1; no two blocks are the same."""
    given = specs(50, 50) if build is gru_actor else specs(50, 50)[:1]
    module = build(*given, initialization="orthogonal")
    named = dict(module.named_parameters())
    blocks = [
        gate for name, p in named.items() if "weight_" in name and "gru" in name
        for gate in p.split(64)
    ]  # fmt: skip
    assert len(blocks) == 3 * 2 * 3
    for block in blocks:
        assert_close(block @ block.T, torch.eye(64), atol=1e-5, rtol=0)
    assert all(not torch.equal(a, b) for a, b in pairwise(blocks))
    (linear,) = (p for p in named.values() if p.shape == (64, 50))
    assert_close(linear.T @ linear, torch.eye(50), atol=1e-5, rtol=0)
    biases = [p for name, p in named.items() if "bias_" in name]
    assert len(biases) == 6
    assert all((p == 0).all() for p in biases)


def test_layers_of_a_stacked_gru_begin_different():
    actor = gru_actor(*specs())
    weights = [p for name, p in actor.named_parameters() if "weight_hh" in name]
    assert len(weights) == 3
    assert not torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[1], weights[2])


def test_past_layers_that_give_nothing_a_residual_actor_is_linear():
    """A cell of zeros keeps a memory of 0: what is left are the two linear layers."""
    actor = gru_actor(*specs(), residual=True, normalize=False, components=0)
    encoder, gru, _, head = actor[0]
    for parameter in gru.parameters():
        parameter.data.zero_()
    td = TensorDict({"observation": torch.randn(2, 50), "is_init": torch.ones(2, 1).bool(),
                     "recurrent_state_actor": torch.zeros(2, 3, 64)}, batch_size=[2])  # fmt: skip
    first, second = encoder.module[0], head.module.mean
    weight = second.weight @ first.weight
    bias = second.weight @ first.bias + second.bias
    assert weight.abs().max() > 1e-4
    assert_close(actor.get_dist(td).mean, td["observation"] @ weight.T + bias)


def test_an_encoder_and_layers_behind_the_memory_are_those_of_an_mlp():
    """With cells of zeros and a residual what is left is the encoder, a linear layer, the layers
    behind and the head, by hand."""
    actor = gru_actor(
        *specs(), encoder_cells=[24], num_cells=[32], activation="tanh", residual=True,
        normalize=False, components=0, num_layers=1,
    )  # fmt: skip
    encoder, gru, _, last = actor[0]
    for parameter in gru.parameters():
        parameter.data.zero_()
    td = TensorDict({"observation": torch.randn(2, 50), "is_init": torch.ones(2, 1).bool(),
                     "recurrent_state_actor": torch.zeros(2, 1, 64)}, batch_size=[2])  # fmt: skip
    first, second = encoder.module[0][0], encoder.module[1]
    third, head = last.module[0][0], last.module[1].mean
    hidden = torch.tanh(td["observation"] @ first.weight.T + first.bias)
    assert hidden.shape == (2, 24)
    hidden = torch.tanh((hidden @ second.weight.T + second.bias) @ third.weight.T + third.bias)
    assert hidden.shape == (2, 32)
    expected = hidden @ head.weight.T + head.bias
    assert expected.abs().max() > 1e-4
    assert_close(actor.get_dist(td).mean, expected)


@pytest.mark.parametrize("residual", [False, True])
def test_replaying_a_sequence_gives_the_log_probabilities_of_collection(residual):
    """With resets at known and at random places, and a state carried in from before."""
    worlds, steps = 6, 40
    actor = gru_actor(*specs(), residual=residual)
    normalizer_of(actor).update(torch.randn(100, 50))
    observation = torch.randn(worlds, steps, 50)
    is_init = torch.rand(worlds, steps, 1) < 0.1
    is_init[0, 7], is_init[1, 0], is_init[2, steps - 1] = True, True, True
    state = torch.randn(worlds, 3, 64) * 0.3
    rows = []
    with torch.no_grad():
        for t in range(steps):
            state = torch.where(is_init[:, t, :, None], 0.0, state)  # as the env does at a reset
            td = TensorDict({"observation": observation[:, t], "is_init": is_init[:, t],
                             "recurrent_state_actor": state}, batch_size=[worlds])  # fmt: skip
            out = actor(td)
            state = out["next", "recurrent_state_actor"]
            rows.append(out)
        batch = torch.stack(rows, 1)
        with set_recurrent_mode(True):
            replayed = actor.get_dist(batch).log_prob(batch["action"])
    assert_close(replayed, batch["action_log_prob"], atol=1e-5, rtol=0)


def test_replay_depends_on_the_stored_state_and_on_the_resets():
    """The test above would see a lost state or a lost reset: both change the replay."""
    actor = gru_actor(*specs())
    batch = TensorDict({"observation": torch.randn(2, 10, 50), "is_init": torch.zeros(2, 10, 1).bool(),
                        "recurrent_state_actor": torch.randn(2, 10, 3, 64)}, batch_size=[2, 10])  # fmt: skip
    action = torch.zeros(2, 10, 20)
    with torch.no_grad(), set_recurrent_mode(True):
        base = actor.get_dist(batch).log_prob(action)
        lost_state = batch.clone()
        lost_state["recurrent_state_actor"].zero_()
        lost_reset = batch.clone()
        lost_reset["is_init"][:, 5] = True
        for other in (lost_state, lost_reset):
            assert (actor.get_dist(other).log_prob(action) - base).abs().max() > 1e-4


def test_orthogonal_layers_keep_their_gain_and_differ():
    """``W W^T = 2 I`` for gain sqrt(2) of a layer that is not taller than wide."""
    trunk = mlp_trunk(32, [32, 32])
    first, second = trunk[0].weight, trunk[2].weight
    for weight in (first, second):
        assert_close(weight @ weight.T, 2 * torch.eye(32), atol=1e-4, rtol=0)
    assert not torch.allclose(first, second)
    own = mlp_trunk(32, [32, 32], initialization="default")
    for layer in (own[0], own[2]):  # torch's: uniform within 1 / sqrt(inputs)
        assert layer.weight.abs().max() <= 32**-0.5
        assert layer.bias.abs().max() > 0
    assert not torch.allclose(own[0].weight, own[2].weight)


def deviation(actor, rows: int = 200, size: float = 1.0) -> torch.Tensor:
    td = TensorDict({"observation": size * torch.randn(rows, 50)}, batch_size=[rows])
    return actor.get_dist(td).variance.sqrt()


def test_deviation_of_the_state_differs_from_state_to_state():
    """``log std = a + w . features``: spread over states by the norm of w, in the mean by a."""
    spec, action_spec = specs()
    same = mlp_actor(spec, action_spec, std=0.3)
    assert deviation(same).std(0).max() < 1e-6
    actor = mlp_actor(spec, action_spec, std=0.3, state_std=True)
    torch.nn.init.orthogonal_(actor[0].module[-1].deviation.weight, 0.5)
    td = TensorDict({"observation": torch.randn(200, 50)}, batch_size=[200])
    net = actor[0].module
    features = net[:-1](td["observation"])
    std = actor.get_dist(td).variance.sqrt()
    assert std.std(0).min() > 0.01
    assert_close(std, 0.3 * (features @ net[-1].deviation.weight.T).exp())
    actor.get_dist(TensorDict({"observation": torch.randn(3, 50)}, [3])).variance.sum().backward()
    assert actor[0].module[-1].deviation.weight.grad.abs().max() > 0


def test_means_of_a_mixture_that_lie_apart_add_to_the_deviation_of_the_action():
    """Means of -s, 0 and s, as likely as each other: their variance is 2 s^2 / 3."""
    actor = mlp_actor(*specs(), components=3, std=0.11, spread=0.09)
    td = TensorDict({"observation": torch.zeros(3, 50)}, batch_size=[3])
    variance = actor.get_dist(td).variance
    assert_close(variance, torch.full_like(variance, 0.11**2 + 2 * 0.09**2 / 3))


@pytest.mark.parametrize("components", [0, 3])
def test_deviation_stays_between_floor_and_cap(components):
    """Of a mixture: the Gaussians', so that the whole can be wider by the distance of means."""
    spec, action_spec = specs()
    actor = mlp_actor(
        spec, action_spec, components=components, std=0.3, std_range=[0.2, 0.4],
        **({} if components else {"state_std": True}),
    )  # fmt: skip
    head = actor[0].module[-1]
    layer = head.linear if components else head.deviation
    torch.nn.init.normal_(layer.weight, std=3.0)
    td = TensorDict({"observation": torch.randn(300, 50)}, batch_size=[300])
    std = actor[0](td)["scale"]
    assert std.min().item() == pytest.approx(0.2, abs=1e-4)
    assert std.max().item() == pytest.approx(0.4, abs=1e-4)


@pytest.mark.parametrize("shared", [False, True])
def test_a_deviation_of_a_mixture_at_its_cap_comes_back_but_goes_no_further(shared):
    spec, action_spec = specs()
    actor = mlp_actor(
        spec, action_spec, components=3, shared_components=shared, std=0.3, std_range=[0.2, 0.4]
    )
    td = TensorDict({"observation": torch.randn(3, 50)}, batch_size=[3])
    head = actor[0].module[-1]
    raw = head.linear.bias.data.view(head.shape)[1]
    raw.fill_(math.log(math.expm1(0.6 - 0.2)))  # softplus gives 0.6 over the floor
    for sign, moves in ((1.0, True), (-1.0, False)):
        scale = actor[0](td)["scale"]
        assert torch.allclose(scale, torch.tensor(0.4))
        (gradient,) = torch.autograd.grad(sign * scale.sum(), head.linear.bias)
        assert bool((gradient.view(head.shape)[1] != 0).all()) is moves


@pytest.mark.parametrize(("start", "bound"), [(0.6, 0.4), (0.1, 0.2)])
def test_a_deviation_at_its_bound_comes_back_but_goes_no_further(start, bound):
    spec, action_spec = specs()
    actor = mlp_actor(spec, action_spec, components=0, std=0.3, std_range=[0.2, 0.4])
    td = TensorDict({"observation": torch.randn(3, 50)}, batch_size=[3])
    parameter = actor[0].module[-1].log_std
    parameter.data.fill_(math.log(start))
    inwards = 1.0 if start > bound else -1.0  # the sign of a loss that falls on the way back
    for sign, moves in ((inwards, True), (-inwards, False)):
        scale = actor[0](td)["scale"]
        assert torch.allclose(scale, torch.tensor(bound))
        (gradient,) = torch.autograd.grad(sign * scale.sum(), parameter)
        assert bool((gradient != 0).all()) is moves


@pytest.mark.parametrize("num_layers", [1, 2])
def test_cells_of_a_gru_remember_for_up_to_so_many_steps(num_layers):
    """Without inputs a cell keeps z of what it holds: it remembers for 1 / (1 - z) steps."""
    actor = gru_actor(*specs(), hidden_size=256, num_layers=num_layers, memory_steps=20)
    (gru,) = (module for module in actor.modules() if isinstance(module, StackedGRU))
    for name, values in gru.named_parameters():
        if "weight" in name:
            torch.nn.init.zeros_(values)
        else:  # what a cell takes in is 0
            torch.nn.init.zeros_(values.data[512:])
    memory = torch.ones(1, num_layers, 256)
    td = TensorDict({gru.in_keys[0]: torch.zeros(1, 256), "is_init": torch.zeros(1, 1).bool()}, [1])
    td[gru.in_keys[1]] = memory
    with torch.no_grad():
        kept = gru(td)[gru.out_keys[1]]
    steps = 1.0 / (1.0 - kept)
    assert 2.0 <= steps.min() < 3.0
    assert 19.0 < steps.max() <= 20.0 + 1e-3
    assert steps.mean().item() == pytest.approx(11.0, abs=1.0)  # uniform from 2 to 20


@pytest.mark.parametrize("steps", [1.5, math.inf])
def test_a_memory_of_no_or_endless_steps_is_refused(steps):
    with pytest.raises(ValueError, match="memory_steps must be at least 2 and finite, got"):
        gru_actor(*specs(), memory_steps=steps)
