"""Loops over worlds at the speed of C, compiled by numba.

Reading out the quantities takes less than half the time that it takes in torch, where it is some
sixty operations.
"""

from collections import namedtuple
from collections.abc import Callable
from typing import Any, NamedTuple, ParamSpec, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from zfall.simulation.quantities import NAMES

P = ParamSpec("P")
T = TypeVar("T")


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """The function, compiled by numba when it is first called, without Python's lock.

    What was compiled is kept on disk for the next process, where there is a folder to keep it in.
    """
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # neither the package's folder nor that of the user's caches
        return numba.njit(nogil=True)(function)


# No state or sensor of a sound world comes near it, in SI units; NaN is not below it.
BOUND = 1e6


@compiled
def sound(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Worlds ``(N,)`` all of whose values ``(N, V)`` are finite and within ``BOUND``."""
    good = np.ones(len(values), np.bool_)
    for i in range(len(values)):
        for value in values[i]:
            good[i] &= abs(value) < BOUND
    return good


class Columns(NamedTuple):
    """Where quantities lie in the state and in ``sensordata``: of vectors, their first value."""

    qpos: NDArray[np.int64]  # of each joint (J,)
    qvel: NDArray[np.int64]
    torque: NDArray[np.int64]
    acceleration: int
    com_position: int
    com_velocity: int
    angular_momentum: int
    feet_position: NDArray[np.int64]  # of each foot (F,)
    feet_orientation: NDArray[np.int64]
    feet_velocity: NDArray[np.int64]
    feet_contact: NDArray[np.int64]  # found, force of the foot on the floor, its center
    corners: NDArray[np.int64]  # forces (F, C)
    parts: NDArray[np.int64]  # forces on the parts of the regions (P,), region by region
    regions: NDArray[np.int64]  # the first of the parts of each, and of one more (R + 1,)


# Arrays ``(N, ...)`` of the quantities, a field each; numba compiles access by name.
Observed: Any = namedtuple("Observed", NAMES)  # type: ignore[misc]


@compiled
def _turned_back(q: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector turned back by a unit quaternion, as ``rotate_inverse``."""
    w, a, b, c = q[0], q[1], q[2], q[3]
    u, v, n = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return x - w * u + (b * n - c * v), y - w * v + (c * u - a * n), z - w * n + (a * v - b * u)


@compiled
def read_out(
    rows: Any,
    qpos: Any,
    qvel: Any,
    sensors: Any,
    gravity: Any,
    mass: Any,
    control_dt: float,
    at: Columns,
    out: Any,
) -> None:
    """Writes the quantities of some worlds into ``out``: one pass over what the physics left.

    ``gravity`` and ``mass`` are of each world, or of all in one row.
    """
    substeps = sensors.shape[1]
    for i in rows:
        last = sensors[i, substeps - 1]
        for j in range(len(at.qpos)):
            out.joint_position[i, j] = qpos[i, at.qpos[j]]
            out.joint_velocity[i, j] = qvel[i, at.qvel[j]]
        for k in range(3):
            out.base_position[i, k] = qpos[i, k]
            out.base_linear_velocity[i, k] = qvel[i, k]
            out.base_angular_velocity[i, k] = qvel[i, 3 + k]
            out.com_position[i, k] = last[at.com_position + k]
            velocity = last[at.com_velocity + k]
            out.com_velocity[i, k] = velocity
            out.linear_momentum[i, k] = mass[i if len(mass) > 1 else 0, 0] * velocity
            out.angular_momentum[i, k] = last[at.angular_momentum + k]
        for k in range(4):
            out.base_orientation[i, k] = qpos[i, 3 + k]
        g = gravity[i if len(gravity) > 1 else 0]
        down = _turned_back(qpos[i, 3:7], g[0], g[1], g[2])
        out.projected_gravity[i, 0] = down[0]
        out.projected_gravity[i, 1] = down[1]
        out.projected_gravity[i, 2] = down[2]
        for f in range(len(at.feet_position)):
            position = last[at.feet_position[f] : at.feet_position[f] + 3]
            orientation = last[at.feet_orientation[f] : at.feet_orientation[f] + 4]
            contact = last[at.feet_contact[f] : at.feet_contact[f] + 7]
            for k in range(3):
                out.feet_position[i, f, k] = position[k]
                out.feet_velocity[i, f, k] = last[at.feet_velocity[f] + k]
                out.feet_force[i, f, k] = -contact[1 + k]
            for k in range(4):
                out.feet_orientation[i, f, k] = orientation[k]
            for c in range(at.corners.shape[1]):
                out.feet_corner_force[i, f, c] = -last[at.corners[f, c] + 2]
            touching = contact[0] > 0.0
            out.feet_contact[i, f] = touching
            # A sole can touch without a force, and has no center then: MuJoCo gives the world's
            # origin.
            if touching and (contact[1] != 0.0 or contact[2] != 0.0 or contact[3] != 0.0):
                x, y, z = contact[4:7] - position
                center = _turned_back(orientation, x, y, z)
                out.feet_cop[i, f, 0] = center[0]
                out.feet_cop[i, f, 1] = center[1]
            else:
                out.feet_cop[i, f] = 0.0
        _over_step(sensors[i], control_dt, at, i, out)


@compiled
def _over_step(sensors: Any, control_dt: float, at: Columns, i: int, out: Any) -> None:
    """Writes what is averaged or peaked over the physics steps ``(S, nsensordata)`` of world i.

    A NaN makes both NaN, though no comparison holds for it.
    """
    substeps, num_regions = len(sensors), len(at.regions) - 1
    torques, acceleration = np.zeros(len(at.torque)), np.zeros(3)
    forces, peaks = np.zeros(num_regions), np.zeros(num_regions)
    torque_peak, square_peak, squares = 0.0, 0.0, 0.0
    for s in range(substeps):  # in the order of memory, which is what it takes time to read
        now = sensors[s]
        for j in range(len(torques)):
            torque = now[at.torque[j]]
            torques[j] += torque
            torque_peak = max(torque_peak, abs(torque))
        square = 0.0
        for k in range(3):
            value = now[at.acceleration + k]
            acceleration[k] += value
            square += value * value
        square_peak, squares = max(square_peak, square), squares + square
        for r in range(num_regions):
            x, y, z = 0.0, 0.0, 0.0  # forces on the parts of a region add up
            for p in range(at.regions[r], at.regions[r + 1]):
                part = at.parts[p]
                x, y, z = x + now[part], y + now[part + 1], z + now[part + 2]
            square = x * x + y * y + z * z
            if square != 0.0:
                norm = np.sqrt(square)
                forces[r] += norm
                peaks[r] = max(peaks[r], norm)
    for j in range(len(torques)):
        out.joint_torque[i, j] = torques[j] / substeps
    total = torques.sum()
    out.joint_torque_peak[i, 0] = total if np.isnan(total) else torque_peak
    for k in range(3):
        out.base_acceleration[i, k] = acceleration[k] / substeps
    out.base_acceleration_peak[i, 0] = squares if np.isnan(squares) else np.sqrt(square_peak)
    for r in range(num_regions):
        out.contact_force_peak[i, r] = forces[r] if np.isnan(forces[r]) else peaks[r]
        out.contact_impulse[i, r] = forces[r] * control_dt / substeps
