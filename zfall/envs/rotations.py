"""Rotations of batches of vectors by unit quaternions (w, x, y, z)."""

import torch
from torch import Tensor


def rotate(quaternion: Tensor, vector: Tensor) -> Tensor:
    """Turns ``vector`` ``(*B, 3)`` by ``quaternion`` ``(*B, 4)``: body axes to world axes."""
    scalar, axis = quaternion[..., :1], quaternion[..., 1:]
    twice = 2.0 * torch.linalg.cross(axis, vector)
    return vector + scalar * twice + torch.linalg.cross(axis, twice)


def rotate_inverse(quaternion: Tensor, vector: Tensor) -> Tensor:
    """Turns ``vector`` back by ``quaternion``: world axes to body axes, shapes as ``rotate``."""
    scalar, axis = quaternion[..., :1], quaternion[..., 1:]
    twice = 2.0 * torch.linalg.cross(axis, vector)
    return vector - scalar * twice + torch.linalg.cross(axis, twice)


def up_axis(quaternion: Tensor) -> Tensor:
    """World up seen from the body ``(*B, 3)``, the third row of the rotation matrix."""
    w, x, y, z = quaternion.unbind(-1)
    up = (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    return torch.stack(up, -1)


def tilt(quaternion: Tensor) -> Tensor:
    """Angle between the body's and the world's up axes ``(*B,)`` [rad], in [0, pi]."""
    up = up_axis(quaternion)
    return torch.atan2(up[..., :2].norm(dim=-1), up[..., 2])
