"""The support polygon: convex hull of the corners of the soles that touch the floor."""

from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.robots import Robot
from zfall.rotations import rotate
from zfall.values import NotNegative

_FLAT = 1e-6  # [m]: closer to a line than this, a point counts as on it


class Hull(NamedTuple):
    """Convex hulls of K points each.

    Attributes:
        points: the points ``(*B, K, 2)`` [m].
        used: which of them count ``(*B, K)`` bool.
        edges: whether the hull runs straight from point i to point j, counterclockwise
            ``(*B, K, K)`` bool.
    """

    points: Tensor
    used: Tensor
    edges: Tensor


def sole_corners(td: TensorDictBase, robot: Robot) -> Tensor:
    """Corners of the soles ``(*B, 2, 4, 3)`` [m; world], in the order of ``robot.corners``.

    Reads ``feet_position`` ``(*B, 2, 3)`` [m] and ``feet_orientation`` ``(*B, 2, 4)``.
    """
    length, width = robot.sole_half_size
    signs = [(1 if "front" in c else -1, 1 if "left" in c else -1) for c in robot.corners]
    position = td["feet_position"]
    local = position.new_tensor([[x * length, y * width, 0.0] for x, y in signs])
    quaternion = td["feet_orientation"].unsqueeze(-2).expand(*position.shape[:-1], len(signs), 4)
    return position.unsqueeze(-2) + rotate(quaternion, local.expand(*quaternion.shape[:-1], 3))


_latest: tuple[Robot, list[tuple[Tensor, int]], Hull] | None = None


def support_hull(td: TensorDictBase, robot: Robot) -> Hull:
    """Support polygon ``(*B, 8, ...)`` from the corners under load, see ``convex_hull``.

    Reads ``feet_position``, ``feet_orientation`` and ``feet_corner_force`` ``(*B, 2, 4)`` [N].
    For the same tensors, not written to since as torch counts it, it returns the same hull again:
    several terms of a table need it. In ``icub_balance`` that saves about a tenth of the time that
    Python takes for a step, which is what the physics waits for.
    """
    global _latest
    read = [td[key] for key in ("feet_position", "feet_orientation", "feet_corner_force")]
    if any(value.is_inference() for value in read):  # of these no one knows if they were changed
        return _support_hull(td, robot)
    latest = _latest
    if latest is not None and latest[0] is robot:
        same = zip(read, latest[1], strict=True)
        if all(value is old and value._version == version for value, (old, version) in same):
            return latest[2]
    hull = _support_hull(td, robot)
    _latest = robot, [(value, value._version) for value in read], hull
    return hull


def _support_hull(td: TensorDictBase, robot: Robot) -> Hull:
    corners = sole_corners(td, robot)[..., :2].flatten(-3, -2)
    return convex_hull(corners, td["feet_corner_force"].flatten(-2) > 0)


def convex_hull(points: Tensor, used: Tensor) -> Hull:
    """Convex hulls of points, all worlds at once.

    The hull runs from point i to point j if every other point lies to the left of that line, or
    on it between the two: the edges are the maximal ones.

    Args:
        points: ``(*B, K, 2)`` [m].
        used: which of them count ``(*B, K)`` bool.
    """
    # The mean is taken off first: coordinates of a few centimeters keep float32 exact enough.
    # Points that do not count are put there, where they change no hull.
    weight = used.unsqueeze(-1).to(points.dtype)
    center = (points * weight).sum(-2, keepdim=True) / weight.sum(-2, keepdim=True).clamp_min(1.0)
    # Worlds come last from here on, which is several times as fast, as is taking each pair of
    # points once: what is left of the way from i to j is right of the way back.
    x, y = ((points - center) * weight).reshape(-1, *points.shape[-2:]).permute(2, 1, 0)
    i, j = torch.triu_indices(len(x), len(x), 1)
    cross = x[:, None] * y - y[:, None] * x  # p_i x p_j (K, K, N)
    apart = (x[:, None] - x).square() + (y[:, None] - y).square()  # |p_j - p_i|^2
    length = apart[i, j].sqrt()  # (pairs, N)
    flat = _FLAT * length
    # (p_j - p_i) x (p_k - p_i) (pairs, k, N)
    left = cross.index_select(0, j) - cross.index_select(0, i) + cross[i, j][:, None]
    # How far p_k is beyond the two ends: 2 (p_k - p_i) . (p_k - p_j).
    beyond = apart.index_select(0, i) + apart.index_select(0, j) - apart[i, j][:, None]
    on_line = flat[:, None] - left.abs()
    spoiled = torch.minimum(on_line, beyond - flat[:, None]).amax(1) > 0
    sound = (length > _FLAT) & ~spoiled
    edges = torch.zeros_like(cross, dtype=torch.bool)
    edges[i, j] = sound & (left.amin(1) >= -flat)
    edges[j, i] = sound & (left.amax(1) <= flat)
    edges = edges.permute(2, 0, 1).reshape(*points.shape[:-1], points.shape[-2])
    return Hull(points, used, edges & used[..., :, None] & used[..., None, :])


def edge_distance(hull: Hull, point: Tensor) -> Tensor:
    """Distance of points from the nearest line through an edge of a hull, negative outside.

    Args:
        hull: of each world.
        point: ``(*B, 2)`` [m].

    Returns:
        ``(*B,)`` [m], how far the hull may shrink before the point is outside; minus infinity
        where the hull has no edge.
    """
    x, y = (point.unsqueeze(-2) - hull.points).unsqueeze(-2).unbind(-1)  # from i (*B, K, 1)
    along_x, along_y = x - x.mT, y - y.mT  # from i to j (*B, K, K)
    length = (along_x.square() + along_y.square()).sqrt_().clamp_min_(1e-9)
    left = (along_x * y - along_y * x) / length
    depth = torch.where(hull.edges, left, torch.inf).flatten(-2).amin(-1)
    return torch.where(depth < torch.inf, depth, -torch.inf)


def distance_inside(hull: Hull, point: Tensor) -> Tensor:
    """Distance of points from the border of a hull, negative outside.

    Args:
        hull: of each world.
        point: ``(*B, 2)`` [m].

    Returns:
        ``(*B,)`` [m]; inside, the distance from the nearest edge, outside minus that from the
        nearest point of the hull; minus infinity where the hull has no point.
    """
    offset = point.unsqueeze(-2) - hull.points  # from i (*B, K, 2)
    x, y = offset.unsqueeze(-2).unbind(-1)
    along_x, along_y = x - x.mT, y - y.mT  # from i to j (*B, K, K)
    square = (along_x.square() + along_y.square()).clamp_min(1e-18)
    place = ((along_x * x + along_y * y) / square).clamp(0.0, 1.0)
    away = (x - place * along_x).square() + (y - place * along_y).square()
    inf = float("inf")
    depth = edge_distance(hull, point)
    outside = torch.where(hull.edges, away, inf).flatten(-2).amin(-1)
    single = torch.where(hull.used, offset.square().sum(-1), inf).amin(-1)
    outside = torch.minimum(outside, single).sqrt()
    has_area = hull.edges.sum((-2, -1)) > 2
    return torch.where(has_area & (depth >= 0), depth, -outside)


def hull_center(hull: Hull) -> Tensor:
    """Centroid of the area of each hull ``(*B, 2)`` [m].

    Mean of the points where they span no area, zero where there is none.
    """
    weight = hull.used.unsqueeze(-1).to(hull.points.dtype)
    mean = (hull.points * weight).sum(-2) / weight.sum(-2).clamp_min(1.0)
    local = hull.points - mean.unsqueeze(-2)
    # Sums over edges of a x b and of (a x b)(a + b), a and b being the ends of the edge.
    x, y = local.unsqueeze(-2).unbind(-1)
    twice = (x * y.mT - y * x.mT) * hull.edges
    moment = ((twice.sum(-1) + twice.sum(-2)).unsqueeze(-1) * local).sum(-2)
    area = twice.flatten(-2).sum(-1, keepdim=True)  # twice of it
    flat = area < 1e-8
    return mean + torch.where(flat, 0.0, moment / (3.0 * area).masked_fill(flat, 1.0))


def com_in_support(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, margin: NotNegative
) -> Tensor:
    """1 where the center of mass lies above the support polygon, shrunk by ``margin`` [m].

    All its edges move inward by that much. Only in double support, 0 else. Reads
    ``com_position`` ``(*B, 3)`` [m], ``feet_contact`` and what ``support_hull`` reads. Returns
    ``(*B, 1)``.

    Source: Ferigo et al., RA-L 2021, section IV-C (CoM projection).
    """
    depth = edge_distance(support_hull(next_td, robot), next_td["com_position"][..., :2])
    both = next_td["feet_contact"].all(-1)
    return ((depth >= margin) & both).float().unsqueeze(-1)
