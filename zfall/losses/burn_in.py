"""Memories refreshed before a sequence is learned from."""

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.modules import set_recurrent_mode

from zfall.modules.actors import recurrent_keys


def burnt_in(batch: TensorDictBase, networks: Iterable[Any], steps: int) -> TensorDictBase:
    """Sequences ``(N, T, ...)`` without their first steps, which only refresh the memory.

    The memory that was stored is that of weights that have changed since; what these networks
    remember after ``steps`` of the sequence, beginning with it, is closer to theirs.
    """
    first, rest = batch[:, :steps], batch[:, steps:].copy()
    begins = rest["is_init"][:, 0]
    for network in networks:
        for key in recurrent_keys(network):
            with torch.no_grad(), set_recurrent_mode(True):
                after = network(first.select(*network.in_keys))["next", key][:, -1]
            memory = rest[key].clone()
            memory[:, 0] = torch.where(begins[..., None], memory[:, 0], after)
            rest[key] = memory
    return rest
