"""Networks that act in the mirror as the robot does there, whatever their weights.

A network f becomes ``(f(o) + M f(M o)) / 2`` with the reflection M: the same function of the image
as the image of the function. Each such function is its own mean, so that none is lost, and each
sample teaches both sides.

A network with a memory has one of here and one of the mirror, which change places there.

Angles that the joint on the other side cannot take are clamped (``zfall.envs.mirror``): there it is
the same up to that. A robot that stands and is pushed straight ahead looks the same in the mirror,
so that such a policy does the same with both legs. ``Handed`` lets it prefer one.

Source: van der Pol et al., "MDP homomorphic networks: group symmetries in reinforcement learning",
NeurIPS 2020; as a mean over the group: Puny et al., "Frame averaging for invariant and equivariant
network design", ICLR 2022.
"""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey
from torch import Tensor, nn

from zfall.modules.mirror import Mirror


class TaskMirror(Mirror):
    """The mirror of a quantity of the task; changes nothing before ``for_task``.

    It is saved with the weights, so that a policy knows it without its task.

    Args:
        key: of the quantity.
        size: its length.
    """

    def __init__(self, key: NestedKey, size: int):
        bound = torch.full((size,), torch.finfo(torch.float32).max)  # checkpoints are finite
        super().__init__(
            torch.arange(size), torch.ones(size), torch.zeros(size), -bound, bound.clone()
        )
        self.key = key

    def for_task(self, task: Any) -> None:
        """Takes over the mirror that the task gives, see ``zfall.training.task_facts``.

        Raises:
            ValueError: if something in the quantity has no mirror image.
        """
        for name, value in task.mirror(self.key).named_buffers():
            getattr(self, name).copy_(value.nan_to_num())


class Handed(nn.Module):
    """Appends an input by which a network may treat the two sides in different ways.

    It is the same number in every state, with the other sign in the mirror. How far the sides then
    differ is up to the weights; with 0 they do not.

    Args:
        handedness: that number.
    """

    def __init__(self, handedness: float):
        super().__init__()
        self.handedness = handedness

    def forward(self, both: Tensor) -> Tensor:
        """``(2, *B, D)``, of here and of the mirror, -> ``(2, *B, D + 1)``."""
        sides = both.new_tensor([self.handedness, -self.handedness])
        sides = sides.reshape(2, *[1] * (both.dim() - 1))
        return torch.cat([both, sides.expand(*both.shape[:-1], 1)], -1)


class SymmetricHead(nn.Module):
    """Parameters of a distribution over actions from features of here and of the mirror.

    Means are mirrored; deviations and weights of a mixture's Gaussians change sides with them.

    Args:
        net: features ``(*B, F)`` -> parameters ``(*B, J)`` or, of a mixture, ``(*B, J, K)``.
        keys: their names, ``loc`` that of the means.
        joints: number of joints J.
    """

    def __init__(self, net: nn.Module, keys: Sequence[str], joints: int):
        super().__init__()
        self.net, self.keys, self.done = net, keys, TaskMirror("action", joints)
        self.axis = -2 if "logits" in keys else -1  # of the joints

    def forward(self, here: Tensor, there: Tensor) -> tuple[Tensor, ...]:
        """The parameters, from features ``(*B, F)``."""
        out = []
        for key, value in zip(self.keys, self.net(torch.stack([here, there])), strict=True):
            if key == "loc":
                image = self.done(value[1].movedim(self.axis, -1)).movedim(-1, self.axis)
            else:
                image = value[1].index_select(self.axis, self.done.index)
            out.append((value[0] + image) / 2.0)
        return tuple(out)


class SymmetricPolicy(nn.Module):
    """Parameters of a distribution over actions that are mirrored where the observation is.

    Args:
        net: ``(*B, D)`` -> parameters, as of ``SymmetricHead``.
        keys: their names.
        size: of the observation D.
        joints: number of joints J.
    """

    def __init__(self, net: nn.Module, keys: Sequence[str], size: int, joints: int):
        super().__init__()
        self.seen = TaskMirror("observation", size)
        self.head = SymmetricHead(net, keys, joints)

    def forward(self, observation: Tensor) -> tuple[Tensor, ...]:
        """The parameters."""
        return self.head(observation, self.seen(observation))


class SymmetricEncoder(nn.Module):
    """What a network makes of an observation and of its mirror image.

    Args:
        net: ``(*B, D)`` -> ``(*B, F)``.
        size: of the observation D.
    """

    def __init__(self, net: nn.Module, size: int):
        super().__init__()
        self.net, self.seen = net, TaskMirror("observation", size)

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Features of here and of the mirror ``(*B, F)``."""
        here, there = self.net(torch.stack([observation, self.seen(observation)]))
        return here, there


class SymmetricValue(nn.Module):
    """The value of a state and of its mirror image, the same for both.

    Args:
        net: ``(*B, D)`` -> ``(*B, 1)``.
        size: of the observation D.
    """

    def __init__(self, net: nn.Module, size: int):
        super().__init__()
        self.net, self.seen = net, TaskMirror("observation_critic", size)

    def forward(self, observation: Tensor) -> Tensor:
        """Values ``(*B, 1)``."""
        return self.net(torch.stack([observation, self.seen(observation)])).mean(0)
