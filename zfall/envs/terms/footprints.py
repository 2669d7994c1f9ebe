"""Footprints: the soles seen from above, on the floor or not."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.robots import Robot


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
    # Worlds come last, which makes sums over the few edges fast.
    x, y = half.flatten(-3, -2).movedim((-1, -2), (0, 1)).contiguous()  # g (4, *B)
    dx, dy = (center[..., 1, :] - center[..., 0, :]).unbind(-1)
    cross = x[:, None] * y - y[:, None] * x  # g_i x g_j (i, j, *B)
    across, width = x * dy - y * dx, cross.abs().sum(1)
    inside = (across.abs() <= width).all(0) & (width > 0).any(0)  # without area: no inside
    # Parallel edges lie one behind the other, in any order as long as it is one: the sign of
    # (i, j) is the opposite of that of (j, i), whatever the rounding.
    upper = torch.ones(4, 4).triu(1).view(4, 4, *[1] * dx.dim())
    sign = torch.where(cross < 0, -upper, upper)
    sign = sign - sign.transpose(0, 1)
    side = torch.where(across < 0, -1.0, 1.0)
    x_off, y_off = dx - side * (sign * x).sum(1), dy - side * (sign * y).sum(1)
    length2 = (x * x + y * y).clamp_min(1e-12)
    share = ((x_off * x + y_off * y) / length2).clamp(-1.0, 1.0)
    away2 = (x_off - share * x).square() + (y_off - share * y).square()
    return away2.amin(0).sqrt().masked_fill(inside, 0.0)
