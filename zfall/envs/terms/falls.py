"""Conditions under which a robot counts as fallen.

Source: the tasks of Ferigo et al. 2021 (contact) and of the Zeroth-fall report (height); the tilt
is ours.
"""

import math

from tensordict import TensorDictBase
from torch import Tensor

from zfall.rotations import cos_tilt
from zfall.values import NotNegative, Positive


def body_contact(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """Whether any region but the feet touched the floor during the step.

    Reads ``contact_force_peak`` ``(*B, R)`` [N], whose last two regions are the feet.
    Returns ``(*B, 1)`` bool.
    """
    return (next_td["contact_force_peak"][..., :-2] > 0).any(-1, keepdim=True)


def tilted(td: TensorDictBase, next_td: TensorDictBase, *, angle: Positive) -> Tensor:
    """Whether the trunk leans by more than ``angle`` [rad].

    Reads ``base_orientation`` ``(*B, 4)``. Returns ``(*B, 1)`` bool.
    """
    return cos_tilt(next_td["base_orientation"]) < math.cos(angle)


def low(td: TensorDictBase, next_td: TensorDictBase, *, height: NotNegative) -> Tensor:
    """Whether the center of mass is lower than ``height`` [m] above the floor.

    Reads ``com_position`` ``(*B, 3)`` [m]. Returns ``(*B, 1)`` bool.
    """
    return next_td["com_position"][..., 2:] < height


def base_height(
    td: TensorDictBase, next_td: TensorDictBase, *, lowest: NotNegative, highest: Positive
) -> Tensor:
    """Whether the base is lower than ``lowest`` or higher than ``highest`` [m].

    Reads ``base_position`` ``(*B, 3)`` [m]. Returns ``(*B, 1)`` bool.
    """
    height = next_td["base_position"][..., 2:]
    return (height < lowest) | (height > highest)
