"""Two policies, of which the mode chooses one."""

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from hydra.utils import instantiate
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.data import Composite

from zfall.modules.actors import recurrent_keys


class SwitchedActor(TensorDictModuleBase):
    """Acts as one policy in mode RECOVER and as another in KNEEL and STABLE.

    Keys: reads ``mode`` ``(*B, 3)`` and what the two read, writes ``action`` ``(*B, J)`` and both
    hidden states.

    Args:
        recover: the policy of mode RECOVER.
        kneel: that of the others.
        begins: whether the memory of the one that kneels begins when it takes over, as in a
            training whose episodes begin in KNEEL; else it remembers what came before.

    Raises:
        ValueError: if both have a memory: they would share its key.
    """

    def __init__(self, recover: Any, kneel: Any, *, begins: bool = False):
        super().__init__()
        if recurrent_keys(recover) and recurrent_keys(kneel):
            raise ValueError("recover and kneel must not both have a memory, got two GRUs.")
        self.recover, self.kneel, self.begins = recover, kneel, begins
        self.in_keys = list(dict.fromkeys([*recover.in_keys, *kneel.in_keys, "mode"]))
        others = [key for key in (*recover.out_keys, *kneel.out_keys) if isinstance(key, tuple)]
        self.out_keys = ["action", *dict.fromkeys(others)]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action."""
        actions, recovers = [], tensordict["mode"][..., :1] > 0
        for actor in (self.recover, self.kneel):
            out = actor(tensordict.select(*actor.in_keys, strict=False))
            actions.append(out["action"])
            for key in self.out_keys[1:]:
                if key not in out.keys(True):
                    continue
                tensordict[key] = out[key]
                if self.begins and actor is self.kneel:
                    rows = recovers.view(*recovers.shape, *[1] * (out[key].ndim - recovers.ndim))
                    tensordict[key] = out[key].masked_fill(rows, 0.0)
        return tensordict.set("action", torch.where(recovers, *actions))


def switched_actor(
    observation_spec: Composite,
    action_spec: Composite,
    *,
    recover: Mapping[str, Any],
    kneel: Mapping[str, Any],
    begins: bool = False,
) -> SwitchedActor:
    """Both policies from their configs; they read the same ``observation``."""
    actors = [instantiate(config, observation_spec, action_spec) for config in (recover, kneel)]
    return SwitchedActor(*actors, begins=begins)


class StillActor(TensorDictModuleBase):
    """Does nothing: as the one that kneels it leaves the way down to the script.

    Keys: reads ``observation`` ``(*B, D)``, writes ``action`` ``(*B, J)``, zeros.

    Args:
        size: of the action J.
    """

    in_keys: ClassVar = ["observation"]
    out_keys: ClassVar = ["action"]

    def __init__(self, size: int):
        super().__init__()
        self.size = size

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action."""
        observation = tensordict["observation"]
        return tensordict.set("action", observation.new_zeros(*observation.shape[:-1], self.size))


def still_actor(observation_spec: Composite, action_spec: Composite) -> StillActor:
    """For an action of this size."""
    return StillActor(action_spec.shape[-1])
