"""Left-right symmetry of a policy: as a loss, or by mirrored data."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import TensorDictPrimer
from torchrl.modules import ProbabilisticActor, set_recurrent_mode
from torchrl.objectives import LossModule

from zfall.modules.actors import recurrent_keys
from zfall.modules.memory import lends_memory, memory_beginning, memory_part, rows_where
from zfall.modules.mirror import Mirror
from zfall.values import FractionBelowOne, NotNegative


class SymmetryLoss(LossModule):
    """Penalises actions that change their side in the mirror other than as the robot does.

    With mu the action without exploration and M the reflection of observations and of actions::

        loss_symmetry = coeff * mean_t |mu(M o_t) - M mu(o_t)|^2

    summed over joints, in units of the action. A recurrent policy goes through the mirrored
    sequence from the memory that it would have there, see ``MirroredMemory``.

    Keys: reads the actor's ``in_keys``, ``(B, ...)`` or sequences ``(N, T, ...)`` of a recurrent
    one, and then ``NAME_mirrored`` of each hidden state. mu(o) is taken from
    ``deterministic_action``, if the batch has it, and then mu(M o) from ``mirrored_action``, if it
    has that. Writes ``loss_symmetry`` ``()``.

    Args:
        actor_network: the policy.
        mirrors: of ``action`` and all that the actor sees, ``observation``.
        coeff: weight.

    Raises:
        ValueError: on a negative weight, or if the actor sees what has no mirror.

    Source: Yu et al., "Learning symmetric and low-energy locomotion", SIGGRAPH 2018.
    """

    companion_key = "mirrored_action"
    actor_network: ProbabilisticActor
    out_keys = ["loss_symmetry"]

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        mirrors: Mapping[NestedKey, Mirror],
        *,
        coeff: NotNegative = 0.5,
    ):
        super().__init__()
        if not 0 <= coeff < math.inf:
            raise ValueError(f"coeff must be finite and not negative, got {coeff}.")
        _check_seen([actor_network], mirrors)
        self.actor_network, self.coeff = actor_network, coeff
        self.mirrors = nn.ModuleDict({_name_of(key): mirror for key, mirror in mirrors.items()})
        self.memories = memories([actor_network], mirrors)
        images = [place for memory in self.memories for place in memory.keys.values()]
        self.in_keys = [*actor_network.in_keys, *images]

    @classmethod
    def for_task(
        cls, actor_network: ProbabilisticActor, task: Any, **values: Any
    ) -> "SymmetryLoss":
        """With the mirrors of the task, see ``zfall.training.task_facts``."""
        keys = [*seen_by([actor_network]), "action"]
        return cls(actor_network, {key: task.mirror(key) for key in keys}, **values)

    def companions(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The mirror image of what the policy read, of which ``mirrored_action`` is to be."""
        image = tensordict.select(*self.actor_network.in_keys)
        for key in seen_by([self.actor_network]):
            image[key] = self.mirrors[_name_of(key)](image[key])
        for memory in self.memories:
            for key, place in memory.keys.items():
                image[key] = tensordict[place]
        return image

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The loss of a batch."""
        mu = tensordict.get("deterministic_action", None)
        mirrored = tensordict.get(self.companion_key, None)
        if mu is None:
            here = tensordict.select(*self.actor_network.in_keys)
            mu, mirrored = self._act(torch.cat([here, self.companions(tensordict)])).chunk(2)
        elif mirrored is None:
            mirrored = self._act(self.companions(tensordict))
        error = (mirrored - self.mirrors["action"](mu)).square().sum(-1).mean()
        return TensorDict({"loss_symmetry": self.coeff * error})

    def _act(self, batch: TensorDictBase) -> Tensor:
        with set_recurrent_mode(bool(self.memories)):
            return self.actor_network.get_dist(batch).deterministic_sample


class SymmetryAugmentation(nn.Module):
    """Puts the mirror image in the place of a share of the samples of a minibatch.

    The image of a step is as likely under the mirrored policy, which would have gathered it, as
    the step under that of collection, and is worth as much: log-probability, advantage and value
    stay. Of recurrent networks whole sequences are mirrored, and begin with the memory that the
    network would have there, see ``MirroredMemory``. A share of one half is unbiased between left
    and right, and costs nothing.

    Keys: reflects those of the mirrors, also under ``"next"``; writes ``mirrored`` ``(B, ...)``
    bool, by which ``PenalizedPPOLoss`` leaves images out of the divergence.

    Args:
        networks: actor and critic.
        mirrors: of ``action``, all that these see, and all that losses read of the world.
        share: part of the samples that are mirrored, each for itself.

    Raises:
        ValueError: on a share outside of [0, 1), or if a network sees what has no mirror.

    Source: Mittal et al., "Symmetry considerations for learning task symmetric robot policies",
    ICRA 2024, who add the images to the samples.
    """

    def __init__(
        self,
        networks: Iterable[TensorDictModuleBase],
        mirrors: Mapping[NestedKey, Mirror],
        *,
        share: FractionBelowOne = 0.5,
    ):
        super().__init__()
        if not 0 <= share < 1:
            raise ValueError(f"share must lie in [0, 1), got {share}.")
        networks = list(networks)
        _check_seen(networks, mirrors)
        self.share, self._keys = share, list(mirrors)
        self.mirrors = nn.ModuleDict({_name_of(key): mirror for key, mirror in mirrors.items()})
        self.memories = memories(networks, mirrors)
        self.in_keys = [place for memory in self.memories for place in memory.keys.values()]

    @classmethod
    def for_task(
        cls, networks: Iterable[TensorDictModuleBase], task: Any, **values: Any
    ) -> "SymmetryAugmentation":
        """With the mirrors of the task, see ``zfall.training.task_facts``."""
        networks = list(networks)
        keys = dict.fromkeys([*seen_by(networks), *task.read_by_losses, "action"])
        return cls(networks, {key: task.mirror(key) for key in keys}, **values)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """A new minibatch ``(B, ...)`` or ``(N, T, ...)``, mirrored in part."""
        rows = torch.rand(len(tensordict)).to(tensordict[self._keys[0]].device) < self.share
        out = tensordict.copy()
        out["mirrored"] = rows.reshape(-1, *[1] * (tensordict.dim() - 1)).expand(tensordict.shape)
        for key, mirror in zip(self._keys, self.mirrors.values(), strict=True):
            for place in (key, ("next", key), f"{_name_of(key)}_neighbour"):
                if (value := tensordict.get(place, None)) is not None:
                    out[place] = rows_where(rows, mirror(value), value)
        for memory in self.memories:
            for key, place in memory.keys.items():
                kept, image = tensordict[key], tensordict[place]
                out[key] = rows_where(rows, image, kept)
                out[place] = rows_where(rows, kept, image)
        return out


class MirroredMemory(TensorDictModuleBase):
    """Lets a recurrent network also follow what it would see if left and right were exchanged.

    Its hidden states there cannot be had by reflecting those it has: only by living through the
    mirrored episode. They travel next to the others in the TensorDict, so that resets, batches and
    checkpoints treat both the same way.

    Keys: reads what the network's memory follows from, and its hidden states in the mirror, under
    their names with ``_mirrored`` behind; writes their successors under ``("next", NAME)``.

    Args:
        network: recurrent actor or critic, whose weights are used.
        mirrors: of the observations that it reads.

    Attributes:
        keys: where each hidden state's image lies.

    Raises:
        ValueError: if it reads something of which there is no mirror.
    """

    def __init__(self, network: Any, mirrors: Mapping[NestedKey, Mirror]):
        super().__init__()
        self.keys = {key: _image_key(key) for key in recurrent_keys(network)}
        self.lends_memory = lends_memory(network)
        # In tuples: parameters and primers of the network alone.
        self._network, self._part = (network,), (memory_part(network),)
        _check_seen([self._part[0]], mirrors)
        self._mirrors = ({key: mirrors[key] for key in seen_by([self._part[0]])},)
        reads = [key for key in self._part[0].in_keys if key not in self.keys]
        self.in_keys = [*reads, *self.keys.values()]
        memory_beginning(network)  # raises if that has no image
        self.out_keys = [unravel_key(("next", key)) for key in self.keys.values()]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """One step of the memory."""
        (part,), (mirrors,) = self._part, self._mirrors
        image = tensordict.select(*(key for key in part.in_keys if key not in self.keys))
        for key, mirror in mirrors.items():
            image[key] = mirror(tensordict[key])
        for key, place in self.keys.items():
            image[key] = tensordict[place]
        after = part(image)["next"]
        for key, place in self.keys.items():
            tensordict["next", place] = after[key]
        return tensordict

    def make_tensordict_primer(self) -> TensorDictPrimer:
        """What the network's own memory begins with."""
        begins = memory_beginning(self._network[0])
        return TensorDictPrimer(
            {place: begins[key][0] for key, place in self.keys.items()},
            default_value={place: begins[key][1] for key, place in self.keys.items()},
            expand_specs=True,
        )


def memories(networks: Iterable[Any], mirrors: Mapping[NestedKey, Mirror]) -> list[MirroredMemory]:
    """A mirrored memory for each of the networks that has one."""
    return [MirroredMemory(network, mirrors) for network in networks if recurrent_keys(network)]


def seen_by(networks: Iterable[Any]) -> list[NestedKey]:
    """What networks see of the world: all that they read but their memory and ``is_init``."""
    keys = [key for network in networks for key in network.in_keys if key != "is_init"]
    memory = {key for network in networks for key in recurrent_keys(network)}
    return list(dict.fromkeys(key for key in keys if key not in memory))


def _check_seen(networks: Iterable[Any], mirrors: Mapping[NestedKey, Mirror]) -> None:
    for key in seen_by(networks):
        if key not in mirrors:
            names = ", ".join(str(name) for name in mirrors)
            raise ValueError(
                f"mirrors must have all that networks see, {key} is missing ({names})."
            )


def _name_of(key: NestedKey) -> str:
    return key if isinstance(key, str) else "/".join(key)


def _image_key(key: NestedKey) -> NestedKey:
    return f"{key}_mirrored" if isinstance(key, str) else (*key[:-1], f"{key[-1]}_mirrored")
