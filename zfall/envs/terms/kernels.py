"""From a measure to a reward in [0, 1]."""

import math

import torch
from torch import Tensor


def rbf(value: Tensor, target: Tensor | float, *, cutoff: float, epsilon: float = 0.01) -> Tensor:
    """``exp(ln(epsilon) |value - target|^2 / cutoff^2)`` over the last dimension.

    1 on the target and ``epsilon`` at the distance ``cutoff`` from it.

    Args:
        value: measure ``(*B, D)``.
        target: of the same shape or unit.
        cutoff: distance at which next to nothing is left, in the unit of ``value``.
        epsilon: what is left there.

    Returns:
        ``(*B, 1)`` in (0, 1].

    Source: Ferigo et al., "On the emergence of whole-body strategies from humanoid robot
    push-recovery learning", RA-L 2021, appendix.
    """
    distance = (value - target).square().sum(-1, keepdim=True)
    return torch.exp(math.log(epsilon) * distance / cutoff**2)
