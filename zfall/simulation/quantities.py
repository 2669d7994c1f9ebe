"""Named physical quantities from the state and the sensor values of a step."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zfall.robots import Robot
from zfall.rotations import rotate_inverse
from zfall.simulation.model import name_in_region
from zfall.simulation.read_quantities import Columns, Observed, read_out
from zfall.simulation.specs import observation_spec

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


class Quantities:
    """Reads the keys of ``HumanoidEnv`` out of MuJoCo's arrays.

    Args:
        robot: gives the names of joints, feet, corners and regions.
        sensors: where each MJCF sensor's values lie in ``sensordata``.
        qpos_index, qvel_index: where each joint's angle and speed lie in the state ``(J,)``.
        mass: total mass [kg].
        control_dt: length of a control step [s].

    Raises:
        ValueError: if a sensor has another number of values than its quantity.
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

        def first(size: int, *names: str) -> NDArray[np.int64]:
            for name in names:  # nothing looks at sizes once it is compiled
                found = sensors[name].stop - sensors[name].start
                if found != size:
                    raise ValueError(f"sensor {name} must have {size} values, got {found}.")
            return np.array([sensors[name].start for name in names])

        def of_feet(name: str, size: int) -> NDArray[np.int64]:
            return first(size, *(f"{name}/{foot}" for foot in robot.feet))

        corners = [[f"feet_corner_force/{f}/{c}" for c in robot.corners] for f in robot.feet]
        parts = [[name for name in sensors if name_in_region(name, r)] for r in robot.regions]
        self.columns = Columns(
            qpos=qpos_index.numpy(),
            qvel=qvel_index.numpy(),
            torque=first(1, *(f"joint_torque/{joint}" for joint in robot.joints)),
            acceleration=int(first(3, "base_acceleration")[0]),
            com_position=int(first(3, "com_position")[0]),
            com_velocity=int(first(3, "com_velocity")[0]),
            angular_momentum=int(first(3, "angular_momentum")[0]),
            feet_position=of_feet("feet_position", 3),
            feet_orientation=of_feet("feet_orientation", 4),
            feet_velocity=of_feet("feet_velocity", 3),
            feet_contact=of_feet("feet_contact", 7),
            corners=np.stack([first(3, *names) for names in corners]),
            parts=np.concatenate([first(3, *names) for names in parts]),
            regions=np.cumsum([0, *(len(names) for names in parts)]),
        )
        spec = observation_spec(robot, 1, with_ball=False)
        self._shapes = {key: tuple(spec[key].shape[1:]) for key in Observed._fields}
        self._shapes["feet_corner_force"] = self.columns.corners.shape

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

        Raises:
            ValueError: on one of ``index`` and ``before`` without the other.
        """
        if (index is None) != (before is None):
            raise ValueError("index and before must be given together, got one of them.")
        if index is None or before is None:
            num, rows = len(qpos), np.arange(len(qpos))
            arrays = {
                key: np.empty((num, *shape), bool if key == "feet_contact" else np.float32)
                for key, shape in self._shapes.items()
            }
        else:
            rows = index.numpy()
            arrays = {key: before[key].numpy().copy() for key in self._shapes}
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
