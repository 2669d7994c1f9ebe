"""Networks that act in the mirror as the robot does there, whatever their weights.

A network f becomes ``(f(o) + M f(M o)) / 2`` with the reflection M: the same function of the image
as the image of the function. Each such function is its own mean, so that none is lost, and each
sample teaches both sides.

Source: van der Pol et al., "MDP homomorphic networks: group symmetries in reinforcement learning",
NeurIPS 2020; as a mean over the group: Puny et al., "Frame averaging for invariant and equivariant
network design", ICLR 2022.
"""

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


class SymmetricPolicy(nn.Module):
    """A Gaussian whose mean is mirrored where the observation is, and its deviations exchanged.

    Args:
        net: ``(*B, D)`` -> ``loc`` and ``scale`` ``(*B, J)``.
        size: of the observation D.
        joints: number of joints J.
    """

    def __init__(self, net: nn.Module, size: int, joints: int):
        super().__init__()
        self.net = net
        self.seen, self.done = TaskMirror("observation", size), TaskMirror("action", joints)

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """``loc`` and ``scale`` ``(*B, J)``."""
        loc, scale = self.net(torch.stack([observation, self.seen(observation)]))
        exchanged = scale[1].index_select(-1, self.done.index)
        return (loc[0] + self.done(loc[1])) / 2.0, (scale[0] + exchanged) / 2.0


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
