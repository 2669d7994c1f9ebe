"""Named physical quantities from the state and the sensor values of a step."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zfall.envs.compiled import compiled
from zfall.envs.model import name_in_region
from zfall.envs.robots import Robot
from zfall.envs.rotations import rotate_inverse
from zfall.envs.specs import observation_spec

# Keys that are known after every physics step.
SUBSTEP_KEYS = (
    "joint_position",
    "joint_velocity",
    "joint_torque",
    "base_position",
    "base_orientation",
    "projected_gravity",
    "base_linear_velocity",
    "base_angular_velocity",
    "base_acceleration",
)
# Largest values over the physics steps: with the last step's they bound all that is observed, but
# for states amid the step, which stay there once they are beyond any physics.
PEAK_KEYS = ("joint_torque_peak", "base_acceleration_peak", "contact_force_peak")


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


class Observed(NamedTuple):
    """Arrays ``(N, ...)`` of the keys of ``HumanoidEnv``, float32 but for ``feet_contact``."""

    joint_position: Any
    joint_velocity: Any
    joint_torque: Any
    joint_torque_peak: Any
    base_position: Any
    base_orientation: Any
    projected_gravity: Any
    base_linear_velocity: Any
    base_angular_velocity: Any
    base_acceleration: Any
    base_acceleration_peak: Any
    com_position: Any
    com_velocity: Any
    linear_momentum: Any
    angular_momentum: Any
    feet_position: Any
    feet_orientation: Any
    feet_velocity: Any
    feet_contact: Any
    feet_force: Any
    feet_cop: Any
    feet_corner_force: Any
    contact_force_peak: Any
    contact_impulse: Any


class Quantities:
    """Reads the keys of ``HumanoidEnv`` out of MuJoCo's arrays.

    Args:
        robot: gives the names of joints, feet, corners and regions.
        sensors: where each MJCF sensor's values lie in ``sensordata``.
        qpos_index, qvel_index: where each joint's angle and speed lie in the state ``(J,)``.
        mass: total mass [kg].
        control_dt: length of a control step [s].
    """

    def __init__(
        self,
        robot: Robot,
        sensors: dict[str, slice],
        qpos_index: Tensor,
        qvel_index: Tensor,
        mass: float,
        control_dt: float,
    ):
        self._control_dt = control_dt
        self.qpos_index, self.qvel_index = qpos_index, qvel_index
        self._mass = np.array([[mass]])
        self._gravity = np.array([[0.0, 0.0, -1.0]])

        def first(*names: str) -> NDArray[np.int64]:
            return np.array([sensors[name].start for name in names])

        def of_feet(name: str) -> NDArray[np.int64]:
            return first(*(f"{name}/{foot}" for foot in robot.feet))

        corners = [[f"feet_corner_force/{f}/{c}" for c in robot.corners] for f in robot.feet]
        parts = [[name for name in sensors if name_in_region(name, r)] for r in robot.regions]
        self.columns = Columns(
            qpos=qpos_index.numpy(),
            qvel=qvel_index.numpy(),
            torque=first(*(f"joint_torque/{joint}" for joint in robot.joints)),
            acceleration=sensors["base_acceleration"].start,
            com_position=sensors["com_position"].start,
            com_velocity=sensors["com_velocity"].start,
            angular_momentum=sensors["angular_momentum"].start,
            feet_position=of_feet("feet_position"),
            feet_orientation=of_feet("feet_orientation"),
            feet_velocity=of_feet("feet_velocity"),
            feet_contact=of_feet("feet_contact"),
            corners=np.stack([first(*names) for names in corners]),
            parts=np.concatenate([first(*names) for names in parts]),
            regions=np.cumsum([0, *(len(names) for names in parts)]),
        )
        spec = observation_spec(robot, 1, with_ball=False)
        self._shapes = {key: tuple(spec[key].shape[1:]) for key in Observed._fields}

    def __call__(
        self,
        qpos: Tensor,
        qvel: Tensor,
        sensors: Tensor,
        gravity: Tensor | None = None,
        mass: Tensor | None = None,
        *,
        index: Tensor | None = None,
        before: dict[Any, Tensor] | None = None,
    ) -> dict[Any, Tensor]:
        """Quantities ``(N, ...)`` float32 of N worlds.

        Args:
            qpos, qvel: states at the end of a control step, float64.
            sensors: sensor values of its S physics steps ``(N, S, nsensordata)``.
            gravity: direction of gravity ``(N, 3)`` [world] if the floor is not level.
            mass: total mass ``(N, 1)`` [kg] if it differs from world to world.
            index: worlds ``(K,)`` to read; all if ``None``. Then
            before: what those of the other worlds are.
        """
        if index is None or before is None:
            num, rows = len(qpos), np.arange(len(qpos))
            arrays = {
                key: np.empty((num, *shape), bool if key == "feet_contact" else np.float32)
                for key, shape in self._shapes.items()
            }
        else:
            rows = index.numpy()
            arrays = {key: before[key].numpy().copy() for key in self._shapes}
        _read(
            rows,
            qpos.numpy(),
            qvel.numpy(),
            sensors.numpy(),
            self._gravity if gravity is None else gravity.double().numpy(),
            self._mass if mass is None else mass.double().numpy(),
            self._control_dt,
            self.columns,
            Observed(**arrays),
        )
        return {key: torch.from_numpy(array) for key, array in arrays.items()}

    def substeps(
        self,
        keys: Iterable[str],
        qpos: Tensor,
        qvel: Tensor,
        sensors: Tensor,
        gravity: Tensor | None = None,
    ) -> dict[str, Tensor]:
        """Quantities ``(K, S, ...)`` float32 after each of the S physics steps.

        Args:
            keys: which, of ``SUBSTEP_KEYS``.
            qpos, qvel: states after each physics step ``(K, S, ...)``, float64.
            sensors: sensor values of the steps ``(K, S, nsensordata)``.
            gravity: direction of gravity ``(K, 3)`` [world] if the floor is not level.
        """
        acceleration = self.columns.acceleration
        down = torch.from_numpy(self._gravity) if gravity is None else gravity.double()
        read: dict[str, Callable[[], Tensor]] = {
            "joint_position": lambda: qpos.float().index_select(-1, self.qpos_index),
            "joint_velocity": lambda: qvel.float().index_select(-1, self.qvel_index),
            "joint_torque": lambda: sensors[..., self.columns.torque],
            "base_position": lambda: qpos[..., :3],
            "base_orientation": lambda: qpos[..., 3:7],
            "projected_gravity": lambda: rotate_inverse(qpos[..., 3:7], down[:, None]),
            "base_linear_velocity": lambda: qvel[..., :3],
            "base_angular_velocity": lambda: qvel[..., 3:6],
            "base_acceleration": lambda: sensors[..., acceleration : acceleration + 3],
        }
        return {key: read[key]().float() for key in keys}


@compiled
def _turned_back(q: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector turned back by a unit quaternion, as ``rotate_inverse``."""
    w, a, b, c = q[0], q[1], q[2], q[3]
    u, v, n = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return x - w * u + (b * n - c * v), y - w * v + (c * u - a * n), z - w * n + (a * v - b * u)


@compiled
def _read(
    rows: Any,
    qpos: Any,
    qvel: Any,
    sensors: Any,
    gravity: Any,
    mass: Any,
    control_dt: float,
    at: Columns,
    out: Observed,
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
def _over_step(sensors: Any, control_dt: float, at: Columns, i: int, out: Observed) -> None:
    """Writes what is averaged or peaked over the physics steps ``(S, nsensordata)`` of world i.

    A value that is not a number makes both one, though no comparison holds for it.
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
