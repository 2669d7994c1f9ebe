"""Footprints: the soles seen from above, on the floor or not."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.robots import Robot


def footprints(td: TensorDictBase, robot: Robot) -> tuple[Tensor, Tensor]:
    """Centers ``(*B, 2, 2)`` and half edges ``(*B, 2, 2, 2)`` [m; world] of the left and right one.

    A sole is a rectangle, its vertical projection the parallelogram of the corners
    ``center +- edge one +- edge two``.

    Reads ``feet_position`` ``(*B, 2, 3)`` [m] and ``feet_orientation`` ``(*B, 2, 4)``.
    """
    length, width = robot.sole_half_size
    q = td["feet_orientation"]
    w, x, y, z = q.unbind(-1)
    wz, xy, yy, zz = w * z, x * y, y * y, z * z
    forward = torch.stack([0.5 - yy - zz, xy + wz], -1)  # half the first column of the rotation
    sideways = torch.stack([xy - wz, 0.5 - x * x - zz], -1)
    half = torch.stack([2.0 * length * forward, 2.0 * width * sideways], -2)
    return td["feet_position"][..., :2], half


def footprint_distance(center: Tensor, half: Tensor) -> Tensor:
    """Distance between the hulls of two footprints ``(*B,)`` [m], 0 where they overlap.

    It is the distance of ``d = center_1 - center_0`` from the sums of all four half edges,
    ``{t_1 g_1 + ... + t_4 g_4, |t_i| <= 1}``. Of this polygon, two sides run along each g_i; the
    one on the side of d has the middle ``+- sum_j sign(g_i x g_j) g_j``.

    Args:
        center: of the two ``(*B, 2, 2)`` [m].
        half: their half edges ``(*B, 2, 2, 2)`` [m]; some may be zero, or all parallel.
    """
    d = center[..., 1:, :] - center[..., :1, :]
    g = half.flatten(-3, -2)  # (*B, 4, 2)
    turned = torch.stack([-g[..., 1], g[..., 0]], -1)
    cross = turned @ g.transpose(-2, -1)  # g_i x g_j (*B, i, j)
    across, along = (turned * d).sum(-1), (g * d).sum(-1)
    overlap = (across.abs() <= cross.abs().sum(-1)).all(-1)
    # Only a polygon without area needs to be looked at from its end, too.
    overlap &= (along.abs() <= (g @ g.transpose(-2, -1)).abs().sum(-1)).all(-1)
    # Parallel edges lie one behind the other, in any order as long as it is one: the sign of
    # (i, j) is the opposite of that of (j, i), whatever the rounding.
    sign = torch.where(cross < 0, -1.0, 1.0).triu(1)
    middle = (sign - sign.transpose(-2, -1)) @ g
    offset = d - torch.where(across < 0, -1.0, 1.0).unsqueeze(-1) * middle
    share = (offset * g).sum(-1) / g.square().sum(-1).clamp_min(1e-12)
    away = offset - share.clamp(-1.0, 1.0).unsqueeze(-1) * g
    return away.norm(dim=-1).amin(-1).masked_fill(overlap, 0.0)
