"""Which joint is on the other side: found by moving one and looking what moves in the mirror."""

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

_CLOSE = 0.05  # of the robot's size: by how much the links of mirrored poses may differ
_TURN = 0.2  # by which a joint is moved [rad]
_POSES, _SHARE = 20, 0.4  # random poses in which a mirror is checked, of the joints' ranges
FLIP = np.diag([1.0, -1.0, 1.0])

Array = NDArray[np.float64]


class Symmetry(NamedTuple):
    """The joint on the other side of each, and the factor on its angle, 1 or -1."""

    partner: tuple[int, ...]
    sign: tuple[float, ...]


def find_symmetry(model: mujoco.MjModel, joints: Sequence[str]) -> Symmetry | None:
    """The mirror of a robot, ``None`` if it is not symmetric.

    A joint is moved from the zero pose, and every other one, by the same angle and by its opposite:
    its mirror is the one that moves the links to the mirrored places. The whole is then checked in
    random poses.

    Args:
        model: the robot with its base upright, facing along x, at zero angles.
        joints: their names.
    """
    size, data = _size(model), mujoco.MjData(model)
    moved = {}
    for sign in (1.0, -1.0):
        for number in range(len(joints)):
            angles = np.zeros(len(joints))
            angles[number] = sign * _TURN
            moved[number, sign] = link_places(model, data, joints, angles, spread=True)
    rest = link_places(model, data, joints, np.zeros(len(joints)), spread=True)
    index, signs = [], []
    for number in range(len(joints)):
        there = {
            (other, sign): _apart(moved[number, 1.0] @ FLIP, moved[other, sign])
            for other in range(len(joints))
            for sign in (1.0, -1.0)
        }
        other, sign = min(there, key=there.__getitem__)
        if there[other, sign] > _CLOSE * size or _apart(rest @ FLIP, rest) > _CLOSE * size:
            return None
        index.append(other)
        signs.append(sign)
    found = Symmetry(tuple(index), tuple(signs))
    return found if asymmetry(model, joints, found) < _CLOSE else None


def asymmetry(model: mujoco.MjModel, joints: Sequence[str], mirror: Symmetry) -> float:
    """Largest way between links of mirrored poses and the mirrored links, in the robot's sizes.

    Infinite where the mirror of the mirror is not the joint itself.
    """
    index, sign = np.array(mirror.partner), np.array(mirror.sign)
    if sorted(index) != list(range(len(joints))) or (index[index] != np.arange(len(index))).any():
        return np.inf
    if (sign * sign[index] < 0).any():
        return np.inf
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    ranges = np.array([_range(model, joint) for joint in joints])
    worst = 0.0
    for _ in range(_POSES):
        angles = generator.uniform(_SHARE * ranges[:, 0], _SHARE * ranges[:, 1])
        here = link_places(model, data, joints, angles)
        there = link_places(model, data, joints, sign * angles[index])
        worst = max(worst, _apart(here @ FLIP, there))
    return worst / _size(model)


def link_places(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    joints: Sequence[str],
    angles: Array,
    *,
    spread: bool = False,
) -> Array:
    """Centers of mass of all links with mass in a pose, from the root's origin ``(K, 3)`` [m].

    With ``spread`` also points beside them, on the principal axes: a turn about the center shows.
    """
    data.qpos[:] = model.qpos0
    data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    data.qpos[[int(model.joint(joint).qposadr[0]) for joint in joints]] = angles
    mujoco.mj_kinematics(model, data)
    links = np.flatnonzero(model.body_mass > 0)
    places = data.xipos[links]
    if not spread:
        return np.array(places)
    arm = 0.2 * _size(model)
    # A box about each center, along the world's axes at rest: turned with the link.
    turns = data.xmat[links].reshape(-1, 3, 3)
    zero = mujoco.MjData(model)
    zero.qpos[:] = model.qpos0
    zero.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(model, zero)
    turned = turns @ zero.xmat[links].reshape(-1, 3, 3).transpose(0, 2, 1)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    around = places[:, None] + arm * np.einsum("bij,kj->bki", turned, axes)
    return np.array(around.reshape(-1, 3))


def _apart(places: Array, others: Array) -> float:
    """Largest way from one of the places to the nearest of the others, both ways [m]."""
    ways = np.linalg.norm(places[:, None] - others, axis=-1)
    return float(max(ways.min(0).max(), ways.min(1).max()))


def _size(model: mujoco.MjModel) -> float:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return float(np.ptp(data.xipos[1:, 2])) or 1.0


def _range(model: mujoco.MjModel, joint: str) -> Array:
    found = model.joint(joint)
    return np.array(found.range if model.jnt_limited[found.id] else [-1.0, 1.0])
