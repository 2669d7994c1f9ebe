"""A network of another framework as the actor of an env."""

from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.data import Unbounded
from torchrl.envs import TensorDictPrimer

from zfall.policies.foreign.network import Network


class ForeignActor(TensorDictModuleBase):
    """Runs a network of another framework, without exploration.

    Keys: reads ``observation`` ``(*B, D)`` and each state ``foreign_NAME`` ``(*B, ...)``; writes
    ``action`` ``(*B, A)`` and the next states, under ``("next", foreign_NAME)``.

    Args:
        network: the network.
        clip: bounds of the action, as the framework clips it before its env takes it.
    """

    def __init__(self, network: Network, clip: tuple[float, float]):
        super().__init__()
        self.network, self.clip = network, clip
        states = {f"foreign_{name}": shape for name, shape in network.states.items()}
        self.states: dict[NestedKey, tuple[int, ...]] = dict(states)
        self.in_keys = ["observation", *states]
        self.out_keys = ["action", *(("next", key) for key in states)]
        self.not_deployed = "run must be trained by zfall to be exported, it is a network already."
        # What tells it from others, see ``zfall.fingerprints.weights_digest``.
        self.register_buffer("digest", torch.tensor([*network.digest], dtype=torch.uint8))
        self.register_buffer("bounds", torch.tensor(clip))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """One step of ``(*B,)``."""
        batch = tensordict.batch_size
        observation, *states = (tensordict[key] for key in self.in_keys)
        rows = (each.reshape(-1, *each.shape[len(batch) :]).numpy() for each in states)
        flat = np.ascontiguousarray(observation.reshape(-1, observation.shape[-1]).numpy())
        action, after = self.network(flat, list(rows))
        bounded = torch.from_numpy(np.clip(action, *self.clip))
        tensordict["action"] = bounded.reshape(*batch, -1)
        for key, value in zip(self.states, after, strict=True):
            next_state = torch.from_numpy(np.ascontiguousarray(value))
            tensordict["next", key] = next_state.reshape(*batch, *value.shape[1:])
        return tensordict

    def make_tensordict_primer(self) -> Any:
        """The transform by which an env carries the states; they begin with 0."""
        specs = {key: Unbounded(shape) for key, shape in self.states.items()}
        return TensorDictPrimer(specs, expand_specs=True)
