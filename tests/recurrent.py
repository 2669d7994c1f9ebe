"""Recurrent networks as a user would write them, of TorchRL's own modules."""

import torch
from tensordict import TensorDictBase
from tensordict.nn import NormalParamExtractor, TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Composite, TensorSpec
from torchrl.modules import (
    GRUModule,
    IndependentNormal,
    LSTMModule,
    ProbabilisticActor,
    ValueOperator,
)

from zfall.modules.actors import gru_actor, recurrent_keys


def lstm(size: int, hidden_size: int, num_layers: int, role: str) -> LSTMModule:
    """From ``embedding`` to ``features``: two hidden states."""
    hidden = [f"recurrent_state_{role}_h", f"recurrent_state_{role}_c"]
    return LSTMModule(
        input_size=size,
        hidden_size=hidden_size,
        num_layers=num_layers,
        in_keys=["embedding", *hidden],
        out_keys=["features", *(("next", key) for key in hidden)],
    )


def gaussian_actor(trunk: list, hidden_size: int, joints: int) -> ProbabilisticActor:
    """A Gaussian whose standard deviation depends on ``features``."""
    head = nn.Sequential(
        nn.Linear(hidden_size, 2 * joints), NormalParamExtractor("biased_softplus_0.3")
    )
    out = TensorDictModule(head, ["features"], ["loc", "scale"])
    return ProbabilisticActor(
        TensorDictSequential(TensorDictSequential(*trunk), out),  # one within the other
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )


def lstm_actor(
    observation_spec: Composite, action_spec: TensorSpec, *, num_layers: int = 1
) -> ProbabilisticActor:
    """Eight numbers in each of two hidden states per layer."""
    size, joints = observation_spec["observation"].shape[-1], action_spec.shape[-1]
    encoder = TensorDictModule(nn.Linear(size, 6), ["observation"], ["embedding"])
    return gaussian_actor([encoder, lstm(6, 8, num_layers, "actor")], 8, joints)


def two_grus_actor(observation_spec: Composite, action_spec: TensorSpec) -> ProbabilisticActor:
    """One GRU after the other, of other widths, the first of two layers."""
    size, joints = observation_spec["observation"].shape[-1], action_spec.shape[-1]
    first = GRUModule(
        input_size=size,
        hidden_size=5,
        num_layers=2,
        in_keys=["observation", "recurrent_state_one", "is_init"],
        out_keys=["embedding", ("next", "recurrent_state_one")],
    )
    second = GRUModule(
        input_size=5,
        hidden_size=8,
        in_keys=["embedding", "recurrent_state_two", "is_init"],
        out_keys=["features", ("next", "recurrent_state_two")],
    )
    return gaussian_actor([first, second], 8, joints)


def small_gru_actor(observation_spec: Composite, action_spec: TensorSpec) -> ProbabilisticActor:
    """Ours, which lends its memory."""
    return gru_actor(observation_spec, action_spec, hidden_size=8, num_layers=2, components=0)


def lstm_critic(observation_spec: Composite) -> TensorDictSequential:
    """With two hidden states of its own."""
    size = observation_spec["observation_critic"].shape[-1]
    encoder = TensorDictModule(nn.Linear(size, 6), ["observation_critic"], ["embedding"])
    value = ValueOperator(nn.Linear(8, 1), in_keys=["features"])
    return TensorDictSequential(encoder, lstm(6, 8, 1, "critic"), value)


ACTORS = {"gru": small_gru_actor, "lstm": lstm_actor, "two grus": two_grus_actor}


def shake(network: nn.Module, size: float = 0.3) -> nn.Module:
    """The network far from its start, where all that it does is small."""
    for parameter in network.parameters():
        parameter.data += size * torch.randn_like(parameter)
    return network


def live_through(network, batch: TensorDictBase, shapes: dict[str, tuple]) -> TensorDictBase:
    """The batch step by step, with the hidden states of each step in it, zero at a reset.

    Args:
        network: whose memory is followed.
        batch: sequences ``(N, T)`` with what it reads besides.
        shapes: of its hidden states.
    """
    like = batch["observation"].new_zeros
    states = {key: like(len(batch), *shape) for key, shape in shapes.items()}
    assert {*recurrent_keys(network)} == {*states}
    steps = []
    for step in batch.unbind(1):
        step = step.clone()
        for key, state in states.items():
            begins = step["is_init"].reshape(-1, *[1] * (state.dim() - 1))
            step[key] = torch.where(begins, 0.0, state)
        with torch.no_grad():
            after = network(step.clone())["next"]
        states = {key: after[key] for key in states}
        steps.append(step)
    return torch.stack(steps, 1)


SHAPES = {  # of the hidden states of ACTORS
    "gru": {"recurrent_state_actor": (2, 8)},
    "lstm": dict.fromkeys(("recurrent_state_actor_h", "recurrent_state_actor_c"), (1, 8)),
    "two grus": {"recurrent_state_one": (2, 5), "recurrent_state_two": (1, 8)},
}
