"""Where the surfaces of links are: their lowest points, and the soles that these make."""

from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_RIM = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
_THIN = 0.02  # share of a foot's size within which of the lowest point the sole lies
_ALIGNED = np.cos(0.2)  # an axis of a link that is so close to upright is the sole's


class Sole(NamedTuple):
    """The flat part of a foot that stands on the floor.

    Attributes:
        link: the foot's.
        position: of its center in the link's frame ``(3,)`` [m].
        quaternion: of its axes, x forward, y left, z up, in the link's frame ``(4,)``.
        half_size: half its length and half its width [m].
    """

    link: str
    position: Array
    quaternion: Array
    half_size: tuple[float, float]


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom meets a floor that has both collision bits 1, or that of the model.

    A ``pair`` of it and the model's floor counts as well.
    """
    kind, takes = int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])
    floor = _floor(model)
    pairs = zip(model.pair_geom1, model.pair_geom2, strict=True)
    if any({*pair} == {geom, floor} for pair in pairs):
        return True
    floor_kind, floor_takes = (
        (1, 1)
        if floor is None
        else (int(model.geom_contype[floor]), int(model.geom_conaffinity[floor]))
    )
    return bool((kind & floor_takes) | (floor_kind & takes))


def _floor(model: mujoco.MjModel) -> int | None:
    planes = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0)
    return int(np.flatnonzero(planes)[0]) if planes.any() else None


def geoms_of(model: mujoco.MjModel, bodies: Iterable[int]) -> list[int]:
    """Geoms of some bodies that can meet the floor."""
    own = set(bodies)
    return [g for g in range(model.ngeom) if model.geom_bodyid[g] in own and collides(model, g)]


def bottom_points(model: mujoco.MjModel, data: mujoco.MjData, geom: int, up: Array) -> Array:
    """Points of a geom ``(K, 3)`` [m; world], its lowest ones along ``up`` among them."""
    size, kind = model.geom_size[geom], int(model.geom_type[geom])
    turn, place = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    match mujoco.mjtGeom(kind):
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return np.array(place - size[0] * up)[None]
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            ends = np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]])
            return place + ends @ turn.T - size[0] * up
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            rim = size[0] * np.stack([np.cos(_RIM), np.sin(_RIM), 0 * _RIM], -1)
            half = np.array([0.0, 0.0, size[1]])
            ends = np.concatenate([rim - half, rim + half])
            return place + ends @ turn.T
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            local = turn.T @ up
            lowest = -(size**2) * local / np.linalg.norm(size * local)
            return (place + turn @ lowest)[None]
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            return place + model.mesh_vert[first : first + count] @ turn.T
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return place + (corners * size) @ turn.T


def sole_of(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int]) -> Sole:
    """The sole of a foot as it stands in ``data``: the rectangle around its lowest points.

    Args:
        model, data: the robot in its reference pose, upright and facing along x.
        bodies: of the foot, its link first, then toes.
    """
    link = bodies[0]
    axes = _axes(data.xmat[link].reshape(3, 3))
    geoms = geoms_of(model, bodies)
    points = np.concatenate([bottom_points(model, data, g, axes[:, 2]) for g in geoms]) @ axes
    thin = _THIN * float(np.ptp(points, axis=0)[:2].max())
    flat = points[points[:, 2] <= points[:, 2].min() + max(thin, 1e-3)]
    low, high = flat.min(0), flat.max(0)
    center = axes @ np.array([*(low + high)[:2] / 2, points[:, 2].min()])
    turn = data.xmat[link].reshape(3, 3).T
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, (turn @ axes).ravel())
    half = np.maximum((high - low)[:2] / 2, 1e-3)  # that of a ball is a point
    return Sole(
        model.body(link).name,
        turn @ (center - data.xpos[link]),
        quaternion,
        (float(half[0]), float(half[1])),
    )


def _axes(turn: Array) -> Array:
    """Axes of a sole in its columns: those of the link that come closest to the world's.

    A link whose axes lie askew has the world's in the reference pose.
    """
    up, forward = (_nearest(turn, np.eye(3)[axis]) for axis in (2, 0))
    if up[2] < _ALIGNED or abs(up @ forward) > 0.5:
        return np.eye(3)
    return np.stack([forward, np.cross(up, forward), up], -1)


def _nearest(turn: Array, direction: Array) -> Array:
    """Of a frame's axes and their opposites the one that is closest to a direction."""
    along = direction @ turn
    axis = int(np.abs(along).argmax())
    found: Array = np.sign(along[axis]) * turn[:, axis]
    return found
