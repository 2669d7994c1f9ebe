"""Left-right symmetry of a policy: as a loss, or by mirrored data."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Unbounded
from torchrl.envs import TensorDictPrimer
from torchrl.modules import ProbabilisticActor, set_recurrent_mode
from torchrl.objectives import LossModule

from zfall.modules.actors import recurrent_keys
from zfall.modules.mirror import Mirror


class SymmetryLoss(LossModule):
    """Penalises actions that change their side in the mirror other than as the robot does.

    With mu the action without exploration and M the reflection of observations and of actions::

        loss_symmetry = coeff * mean_t |mu(M o_t) - M mu(o_t)|^2

    summed over joints, in units of the action. A recurrent policy goes through the mirrored
    sequence from the memory that it would have there, see ``MirroredMemory``.

    Keys: reads the actor's ``in_keys``, ``(B, ...)`` or sequences ``(N, T, ...)`` of a recurrent
    one, and then ``recurrent_state_actor_mirrored``. mu(o) is taken from ``deterministic_action``,
    if the batch has it, and then mu(M o) from ``mirrored_action``, if it has that. Writes
    ``loss_symmetry`` ``()``.

    Args:
        actor_network: the policy.
        mirrors: of ``observation`` and ``action``.
        coeff: weight.

    Raises:
        ValueError: on a negative weight.

    Source: Yu et al., "Learning symmetric and low-energy locomotion", SIGGRAPH 2018.
    """

    companion_key = "mirrored_action"
    actor_network: ProbabilisticActor
    out_keys = ["loss_symmetry"]

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        mirrors: Mapping[str, Mirror],
        *,
        coeff: float = 0.5,
    ):
        super().__init__()
        if not 0 <= coeff < math.inf:
            raise ValueError(f"coeff must be finite and not negative, got {coeff}.")
        self.actor_network, self.coeff = actor_network, coeff
        self.mirrors = nn.ModuleDict(mirrors)
        self.memories = memories([actor_network], mirrors)
        self.in_keys = [*actor_network.in_keys, *(memory.key for memory in self.memories)]

    @classmethod
    def for_task(
        cls, actor_network: ProbabilisticActor, task: Any, **values: Any
    ) -> "SymmetryLoss":
        """With the mirrors of the task, see ``zfall.training.task_facts``."""
        return cls(
            actor_network, {key: task.mirror(key) for key in ("observation", "action")}, **values
        )

    def companions(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The mirror image of what the policy read, of which ``mirrored_action`` is to be."""
        image = tensordict.select(*self.actor_network.in_keys)
        image["observation"] = self.mirrors["observation"](image["observation"])
        for memory in self.memories:
            image[memory.hidden] = tensordict[memory.key]
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
        mirrors: of ``observation``, ``observation_critic`` and ``action``.
        share: part of the samples that are mirrored, each for itself.

    Raises:
        ValueError: on a share outside of [0, 1).

    Source: Mittal et al., "Symmetry considerations for learning task symmetric robot policies",
    ICRA 2024, who add the images to the samples.
    """

    def __init__(
        self,
        networks: Iterable[TensorDictModuleBase],
        mirrors: Mapping[str, Mirror],
        *,
        share: float = 0.5,
    ):
        super().__init__()
        if not 0 <= share < 1:
            raise ValueError(f"share must lie in [0, 1), got {share}.")
        self.share = share
        self.mirrors = nn.ModuleDict(mirrors)
        self.memories = memories(networks, mirrors)
        self.in_keys = [memory.key for memory in self.memories]

    @classmethod
    def for_task(
        cls, networks: Iterable[TensorDictModuleBase], task: Any, **values: Any
    ) -> "SymmetryAugmentation":
        """With the mirrors of the task, see ``zfall.training.task_facts``."""
        keys = ("observation", "observation_critic", "action")
        return cls(networks, {key: task.mirror(key) for key in keys}, **values)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """A new minibatch ``(B, ...)`` or ``(N, T, ...)``, mirrored in part."""
        rows = torch.rand(len(tensordict)) < self.share
        out = tensordict.copy()
        out["mirrored"] = rows.reshape(-1, *[1] * (tensordict.dim() - 1)).expand(tensordict.shape)
        for key, mirror in self.mirrors.items():
            for place in (key, ("next", key), f"{key}_neighbour"):
                if (value := tensordict.get(place, None)) is not None:
                    out[place] = _where(rows, mirror(value), value)
        for memory in self.memories:
            kept, image = tensordict[memory.hidden], tensordict[memory.key]
            out[memory.hidden] = _where(rows, image, kept)
            out[memory.key] = _where(rows, kept, image)
        return out


class MirroredMemory(TensorDictModuleBase):
    """Lets a recurrent network also follow what it would see if left and right were exchanged.

    Its hidden state there cannot be had by reflecting the one it has: only by living through the
    mirrored episode. It travels beside the other in the TensorDict, so that resets, batches and
    checkpoints treat both alike.

    Keys: reads the network's observation, ``is_init`` and ``key``, the hidden state in the mirror
    ``(*B, layers, H)``, whose successor it writes under ``("next", key)``.

    Args:
        network: recurrent actor or critic, whose weights are used.
        mirror: of its observation.
    """

    def __init__(self, network: Any, mirror: Mirror):
        super().__init__()
        (self.hidden,) = recurrent_keys(network)
        self.key = f"{self.hidden}_mirrored"
        # Encoder and GRU, held in a tuple: parameters of the network alone.
        parts = network[0] if isinstance(network, ProbabilisticActor) else network
        self._parts = (parts[0], parts[1])
        self.observation = parts[0].in_keys[0]
        self.mirror = (mirror,)
        self.in_keys = [self.observation, "is_init", self.key]
        self.out_keys = [("next", self.key)]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """One step of the memory."""
        encoder, gru = self._parts
        image = tensordict.select("is_init")
        image[self.observation] = self.mirror[0](tensordict[self.observation])
        image[self.hidden] = tensordict[self.key]
        after = gru(encoder(image))["next", self.hidden]
        return tensordict.set(("next", self.key), after)

    def make_tensordict_primer(self) -> TensorDictPrimer:
        """Zeros at the beginning of an episode."""
        gru = self._parts[1].gru
        return TensorDictPrimer(
            {self.key: Unbounded((gru.num_layers, gru.hidden_size))}, expand_specs=True
        )


def memories(networks: Iterable[Any], mirrors: Mapping[str, Mirror]) -> list[MirroredMemory]:
    """A mirrored memory for each of the networks that has one."""
    found = []
    for network in networks:
        if recurrent_keys(network):
            parts = network[0] if isinstance(network, ProbabilisticActor) else network
            found.append(MirroredMemory(network, mirrors[parts[0].in_keys[0]]))
    return found


def _where(rows: Tensor, image: Tensor, kept: Tensor) -> Tensor:
    return torch.where(rows.reshape(-1, *[1] * (kept.dim() - 1)), image, kept)
