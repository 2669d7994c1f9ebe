"""Named physical quantities from the state and the sensor values of a step."""

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zfall.robots import Robot
from zfall.rotations import rotate_inverse
from zfall.simulation.compiled import Columns, Observed, read_out
from zfall.simulation.model import name_in_region
from zfall.simulation.quantities import PLACES, QUANTITIES, needed_sensors

_NUMPY = {torch.float32: np.dtype(np.float32), torch.bool: np.dtype(bool)}


class QuantityReader:
    """Reads ``QUANTITIES`` out of MuJoCo's arrays.

    Args:
        robot: gives the names of joints, feet, corners and regions.
        model: gives where the joints lie in the state.
        sensors: where each MJCF sensor's values lie in ``sensordata``.
        mass: total mass [kg].
        control_dt: length of a control step [s].

    Attributes:
        places: of each component of the state, which of MuJoCo's arrays it lies in (``qpos``,
            ``qvel``), and in which columns.

    Raises:
        ValueError: if a sensor has another number of values than its quantity.
    """

    def __init__(
        self,
        robot: Robot,
        model: mujoco.MjModel,
        sensors: dict[str, slice],
        *,
        mass: float,
        control_dt: float,
    ):
        self._control_dt = control_dt
        self._mass = np.array([[mass]])
        self._gravity = np.array([[0.0, 0.0, -1.0]])
        joints = [model.joint(name) for name in robot.joints]
        columns = {
            "qpos": torch.tensor([int(joint.qposadr[0]) for joint in joints]),
            "qvel": torch.tensor([int(joint.dofadr[0]) for joint in joints]),
        }
        self.places: dict[str, tuple[str, Tensor | slice]] = {
            key: (place.array, place.columns if place.columns else columns[place.array])
            for key, place in PLACES.items()
        }
        self.columns = _columns(robot, sensors, columns["qpos"], columns["qvel"])
        self._arrays = {str(q.name): (q.size(robot), _NUMPY[q.dtype]) for q in QUANTITIES}

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
        """Quantities ``(N, ...)`` of N worlds.

        Args:
            qpos, qvel: states at the end of a control step, float64.
            sensors: sensor values of its S physics steps ``(N, S, nsensordata)``.
            gravity: direction of gravity ``(N, 3)`` [world] if the floor is not level.
            mass: total mass ``(N, 1)`` [kg] if it differs from world to world.
            index: worlds ``(K,)`` to read; all if ``None``. Then
            before: what those of the other worlds are.

        Raises:
            ValueError: on one of ``index`` and ``before`` without the other.
        """
        if (index is None) != (before is None):
            raise ValueError("index and before must be given together, got one of them.")
        if index is None or before is None:
            num, rows = len(qpos), np.arange(len(qpos))
            arrays = {
                key: np.empty((num, *shape), kind) for key, (shape, kind) in self._arrays.items()
            }
        else:
            rows = index.numpy()
            arrays = {key: before[key].numpy().copy() for key in self._arrays}
        read_out(
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

        Raises:
            ValueError: on a key that is not known after each physics step.
        """
        states = {"qpos": qpos, "qvel": qvel}

        def read(key: str) -> Tensor:
            if key in self.places:
                array, columns = self.places[key]
                if isinstance(columns, slice):
                    return states[array][..., columns]
                return states[array].float().index_select(-1, columns)
            match key:
                case "joint_torque":
                    return sensors[..., self.columns.torque]
                case "projected_gravity":
                    down = torch.from_numpy(self._gravity) if gravity is None else gravity.double()
                    return rotate_inverse(qpos[..., 3:7], down[:, None])
                case "base_acceleration":
                    first = self.columns.acceleration
                    return sensors[..., first : first + 3]
            raise ValueError(f"keys must be of SUBSTEP_KEYS, got {key}.")

        return {key: read(key).float() for key in keys}


def _columns(
    robot: Robot, sensors: dict[str, slice], qpos_index: Tensor, qvel_index: Tensor
) -> Columns:
    """Where the compiled reader finds what it reads; raises ``ValueError`` on wrong sizes."""
    parts = [[name for name in sensors if name_in_region(name, r)] for r in robot.regions]
    sizes = needed_sensors(robot) | {name: 3 for names in parts for name in names}
    for name, size in sizes.items():  # nothing looks at sizes once it is compiled
        found = sensors[name].stop - sensors[name].start
        if found != size:
            raise ValueError(f"sensor {name} must have {size} values, got {found}.")

    def first(*names: str) -> NDArray[np.int64]:
        return np.array([sensors[name].start for name in names])

    def of_feet(name: str) -> NDArray[np.int64]:
        return first(*(f"{name}/{foot}" for foot in robot.feet))

    corners = [[f"feet_corner_force/{f}/{c}" for c in robot.corners] for f in robot.feet]
    return Columns(
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
