"""How much a policy explores."""

from contextlib import suppress
from typing import Any

import torch
from tensordict import TensorDictBase

from zfall.losses.policy_pass import policy_pass
from zfall.training.own_draws import own_draws

WORLDS = 16  # that are looked at


@torch.no_grad()
def exploration_of(actor: Any, batch: TensorDictBase) -> dict[str, float]:
    """Standard deviation and entropy of a policy's actions, ``policy/std`` and ``policy/entropy``.

    Means over a few rows of a batch ``(N, T)`` and over joints; in units of the action, and nats.
    What the distribution does not know is left out.
    """
    device = next(actor.parameters()).device
    some = batch[:WORLDS].select(*actor.in_keys).to(device)
    with own_draws():  # that of a shared mixture is drawn
        policy, _ = policy_pass(actor, some)
        figures = {}
        with suppress(NotImplementedError):
            figures["policy/std"] = policy.variance.sqrt().mean().item()
        with suppress(NotImplementedError):
            figures["policy/entropy"] = policy.entropy().mean().item()
    return figures
