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


def turned(quaternion: Tensor, angle: Tensor) -> Tensor:
    """Orientation ``(*B, 4)`` turned by ``angle`` ``(*B,)`` [rad] about the world's up axis."""
    half = 0.5 * angle.unsqueeze(-1)
    cos, sin = half.cos(), half.sin()
    w, x, y, z = quaternion.split(1, -1)
    return torch.cat(
        [cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], -1
    )


def up_axis(quaternion: Tensor) -> Tensor:
    """World up seen from the body ``(*B, 3)``, the third row of the rotation matrix."""
    w, x, y, z = quaternion.unbind(-1)
    up = (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    return torch.stack(up, -1)


def cos_tilt(quaternion: Tensor) -> Tensor:
    """Cosine of ``tilt`` ``(*B, 1)``: the share of the body's up axis that points up."""
    return 1.0 - 2.0 * quaternion[..., 1:3].square().sum(-1, keepdim=True)


def tilt(quaternion: Tensor) -> Tensor:
    """Angle between the body's and the world's up axes ``(*B,)`` [rad], in [0, pi]."""
    up = up_axis(quaternion)
    return torch.atan2(up[..., :2].norm(dim=-1), up[..., 2])


def roll_and_pitch(up: Tensor) -> Tensor:
    """Roll and pitch ``(*B, 2)`` [rad] of a body, from a vector ``(*B, 3)`` in its axes that
    points up in the world: intrinsic rotations about z, y, x, positive to the right and forward.
    """
    x, y, z = up.unbind(-1)
    return torch.stack([torch.atan2(y, z), torch.atan2(-x, torch.hypot(y, z))], -1)


def from_angles(angles: Tensor) -> Tensor:
    """Quaternion ``(*B, 4)`` of roll, pitch and heading ``(*B, 3)`` [rad].

    Intrinsic rotations about z, y, x by heading, pitch and roll, the angles that ``heading`` and
    ``roll_and_pitch`` give.
    """
    half = 0.5 * angles
    (cr, cp, cy), (sr, sp, sy) = half.cos().unbind(-1), half.sin().unbind(-1)
    return torch.stack(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ],
        -1,
    )


def heading(quaternion: Tensor) -> Tensor:
    """Angle ``(*B, 1)`` [rad] in (-pi, pi] by which the body is turned about the vertical.

    The first of the intrinsic rotations about z, y, x that lead to it.
    """
    w, x, y, z = quaternion.split(1, -1)
    return torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def wrap(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi) [rad]."""
    return torch.remainder(angle + torch.pi, 2.0 * torch.pi) - torch.pi


def turn_between(start: Tensor, end: Tensor) -> Tensor:
    """Quaternion ``(*B, 4)`` of the turn from one orientation to another, in the first one's axes.

    ``conjugate(start) * end``.
    """
    w, axis = start[..., :1], -start[..., 1:]
    v, other = end[..., :1], end[..., 1:]
    scalar = w * v - (axis * other).sum(-1, keepdim=True)
    return torch.cat([scalar, w * other + v * axis + torch.linalg.cross(axis, other)], -1)


def rotation_angle(quaternion: Tensor) -> Tensor:
    """Angle of a rotation the shorter way round ``(*B, 1)`` [rad], in [0, pi]."""
    sine = quaternion[..., 1:].norm(dim=-1, keepdim=True)
    return 2.0 * torch.atan2(sine, quaternion[..., :1].abs())


def rotation_vector(quaternion: Tensor) -> Tensor:
    """Axis times angle ``(*B, 3)`` [rad] of the shorter way round, the logarithm of a rotation."""
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    axis = quaternion[..., 1:]
    sine = axis.norm(dim=-1, keepdim=True)
    angle = 2.0 * torch.atan2(sine, quaternion[..., :1])
    return axis * torch.where(sine > 1e-7, angle / sine.clamp_min(1e-7), 2.0)


def from_rotation_vector(vector: Tensor) -> Tensor:
    """Quaternion ``(*B, 4)`` of axis times angle ``(*B, 3)`` [rad], the exponential."""
    angle = vector.norm(dim=-1, keepdim=True)
    half = 0.5 * angle
    scale = torch.where(angle > 1e-7, half.sin() / angle.clamp_min(1e-7), 0.5)
    return torch.cat([half.cos(), scale * vector], -1)


def turn_to_heading(quaternion: Tensor, vector: Tensor) -> Tensor:
    """A level vector ``(*B, 2)`` of the world, seen along the heading of a body.

    Args:
        quaternion: orientation of the body ``(*B, 4)``.
        vector: in world axes.
    """
    angle = heading(quaternion)
    cos, sin = angle.cos(), angle.sin()
    x, y = vector.split(1, -1)
    return torch.cat([cos * x + sin * y, cos * y - sin * x], -1)


def mean_orientation(left: Tensor, right: Tensor) -> Tensor:
    """Orientation halfway between two ``(*B, 4)``: their sum, normalised.

    A quaternion and its negative mean the same, so the second is given the sign of the first.
    """
    same = (left * right).sum(-1, keepdim=True) >= 0
    return torch.nn.functional.normalize(left + torch.where(same, right, -right), dim=-1)
