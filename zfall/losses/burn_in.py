"""Memories refreshed before a sequence is learned from."""

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDictBase

from zfall.modules.actors import recurrent_keys
from zfall.modules.memory import memory_after, rows_where


def burnt_in(batch: TensorDictBase, networks: Iterable[Any], steps: int) -> TensorDictBase:
    """Sequences ``(N, T, ...)`` without their first steps, which only refresh the memory.

    The memory that was stored is that of weights that have changed since; what these networks
    remember after ``steps`` of the sequence, beginning with it, is closer to theirs.
    """
    first, rest = batch[:, :steps], batch[:, steps:].copy()
    begins = rest["is_init"][:, 0]
    for network in networks:
        if not recurrent_keys(network):
            continue
        with torch.no_grad():
            after = memory_after(network, first)
        for key, refreshed in after.items():
            memory = rest[key].clone()
            memory[:, 0] = rows_where(begins, memory[:, 0], refreshed)
            rest[key] = memory
    return rest
