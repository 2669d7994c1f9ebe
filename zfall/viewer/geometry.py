"""From a MuJoCo model to meshes that a browser can show, and where they are."""

from typing import Any

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.creation import box, capsule, cylinder, icosphere
from trimesh.visual import ColorVisuals

Array = NDArray[np.float64]
Color = tuple[float, float, float]

HIDDEN_GROUP = 3  # MuJoCo's viewer, too, shows groups of geoms below it alone
_GEOM = mujoco.mjtGeom


def body_meshes(
    model: mujoco.MjModel, tint: Color | None = None, share: float = 0.45
) -> dict[int, trimesh.Trimesh]:
    """One colored mesh for each body that has something to show, by the body's number.

    Bodies that are welded together share the mesh of the one that moves them. Planes are left out.

    Args:
        model: the compiled model.
        tint: color that all others are mixed with, red, green and blue in [0, 1].
        share: of the tint in the mixture.

    Returns:
        Meshes with vertices in the axes of their body [m].

    Raises:
        ValueError: on a kind of geom that has no mesh here.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    parts: dict[int, list[trimesh.Trimesh]] = {}
    for geom in range(model.ngeom):
        if model.geom_type[geom] == _GEOM.mjGEOM_PLANE:
            continue
        if model.geom_group[geom] >= HIDDEN_GROUP or model.geom_rgba[geom, 3] == 0:
            continue
        body = int(model.body_weldid[model.geom_bodyid[geom]])
        mesh = _mesh(model, geom)
        of_geom = _pose(data.geom_xpos[geom], data.geom_xmat[geom])
        of_body = _pose(data.xpos[body], data.xmat[body])
        mesh.apply_transform(np.linalg.inv(of_body) @ of_geom)
        mesh.visual = ColorVisuals(
            mesh, vertex_colors=np.tile(_color(model, geom, tint, share), (len(mesh.vertices), 1))
        )
        parts.setdefault(body, []).append(mesh)
    return {body: _joined(meshes) for body, meshes in parts.items()}


class Poses:
    """Where bodies are in given states.

    Args:
        model: the compiled model.
        bodies: their numbers, K of them.
    """

    def __init__(self, model: mujoco.MjModel, bodies: list[int]):
        self._model, self._data, self._bodies = model, mujoco.MjData(model), bodies

    def __call__(self, qpos: Array) -> tuple[Array, Array]:
        """Positions ``(K, 3)`` [m] and quaternions ``(K, 4)`` (w, x, y, z) in a state ``(nq,)``."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        return self._data.xpos[self._bodies], self._data.xquat[self._bodies]


def arrow(length: float, radius: float = 0.008) -> trimesh.Trimesh:
    """A red arrow along z whose tip lies in the origin.

    Args:
        length: of the whole arrow [m].
        radius: of its shaft [m].
    """
    head = min(0.05, length / 2)
    tip = trimesh.creation.cone(radius=2.5 * radius, height=head)
    tip.apply_translation([0, 0, -head])
    shaft = cylinder(radius=radius, height=length - head)
    shaft.apply_translation([0, 0, -head - (length - head) / 2])
    whole = _joined([shaft, tip])
    red = np.tile(np.array([220, 30, 30, 255], np.uint8), (len(whole.vertices), 1))
    whole.visual = ColorVisuals(whole, vertex_colors=red)
    return whole


def along(direction: Array) -> Array:
    """The quaternion ``(4,)`` (w, x, y, z) that turns the z axis into a direction ``(3,)``."""
    turn = trimesh.geometry.align_vectors([0, 0, 1], direction)
    return np.asarray(trimesh.transformations.quaternion_from_matrix(turn))


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == _GEOM.mjGEOM_BOX:
        return box(2 * size)
    if kind == _GEOM.mjGEOM_SPHERE:
        return icosphere(subdivisions=2, radius=size[0])
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        ball = icosphere(subdivisions=2)
        ball.apply_scale(size)
        return ball
    if kind == _GEOM.mjGEOM_CAPSULE:
        rounded = capsule(height=2 * size[1], radius=size[0], count=[12, 12])
        rounded.apply_translation(-rounded.bounds.mean(0))
        return rounded
    if kind == _GEOM.mjGEOM_CYLINDER:
        return cylinder(radius=size[0], height=2 * size[1], sections=16)
    if kind == _GEOM.mjGEOM_MESH:
        index = int(model.geom_dataid[geom])
        first, count = model.mesh_vertadr[index], model.mesh_vertnum[index]
        face, faces = model.mesh_faceadr[index], model.mesh_facenum[index]
        return trimesh.Trimesh(
            model.mesh_vert[first : first + count],
            model.mesh_face[face : face + faces],
            process=False,
        )
    raise ValueError(
        f"geom {model.geom(geom).name!r} must be a box, sphere, ellipsoid, capsule, cylinder or "
        f"mesh to be shown, got {_GEOM(kind).name}."
    )


def _joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    whole: Any = trimesh.util.concatenate(meshes)
    return whole


def _pose(position: Array, matrix: Array) -> Array:
    """A homogeneous matrix ``(4, 4)``."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrix.reshape(3, 3), position
    return pose


def _color(model: mujoco.MjModel, geom: int, tint: Color | None, share: float) -> NDArray[np.uint8]:
    material = int(model.geom_matid[geom])
    rgba = (model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]).astype(float)
    if tint is not None:
        rgba[:3] = (1 - share) * rgba[:3] + share * np.array(tint)
    return np.round(255 * rgba).astype(np.uint8)
