"""Named physical quantities from the state and the sensor values of a step."""

from collections.abc import Callable, Iterable

import numpy as np
import torch
from tensordict import NestedKey
from torch import Tensor

from zfall.envs.model import name_in_region
from zfall.envs.robots import Robot
from zfall.envs.rotations import rotate_inverse, up_axis

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
        self.qpos_index, self.qvel_index, self.mass = qpos_index, qvel_index, mass

        def columns(*names: str) -> Tensor:
            places = [torch.arange(sensors[name].start, sensors[name].stop) for name in names]
            return torch.stack(places)

        torque = columns(*(f"joint_torque/{joint}" for joint in robot.joints))
        acceleration = columns("base_acceleration")
        self._torque = _span(torque)
        self._last: dict[str, tuple[slice | Tensor, tuple[int, ...]]] = {
            key: (_span(columns(key)), (3,))
            for key in ("com_position", "com_velocity", "angular_momentum")
        }
        for key, size in (("feet_position", 3), ("feet_orientation", 4), ("feet_velocity", 3)):
            places = columns(*(f"{key}/{foot}" for foot in robot.feet))
            self._last[key] = (_span(places), (len(robot.feet), size))
        self._contact = _span(columns(*(f"feet_contact/{foot}" for foot in robot.feet)))
        corners = (f"{foot}/{corner}" for foot in robot.feet for corner in robot.corners)
        self._corners = columns(*(f"feet_corner_force/{corner}" for corner in corners))[:, 2]
        self._num_feet = len(robot.feet)
        # Forces on the parts of a region add up: x of all regions, then y, then z. The acceleration
        # stands behind them, for the same is done with it.
        regions = enumerate(robot.regions)
        named = [(i, name) for i, r in regions for name in sensors if name_in_region(name, r)]
        vectors = torch.cat([columns(*(sensor for _, sensor in named)), acceleration])
        targets = [*(i for i, _ in named), len(robot.regions)]
        read = vectors.flatten().sort().values  # side by side in our MJCF, which is faster
        self._vectors = _span(read)
        self._acceleration = _span(torch.searchsorted(read, acceleration))
        num = len(robot.regions) + 1
        self._sum = torch.zeros(len(read), 3 * num)
        for target, vector in zip(targets, torch.searchsorted(read, vectors), strict=True):
            self._sum[vector, torch.arange(3) * num + target] = 1.0

    def __call__(
        self,
        qpos: Tensor,
        qvel: Tensor,
        sensors: Tensor,
        gravity: Tensor | None = None,
        mass: Tensor | None = None,
    ) -> dict[NestedKey, Tensor]:
        """Quantities ``(K, ...)`` float32 of K worlds.

        Args:
            qpos, qvel: states at the end of a control step, float64.
            sensors: sensor values of its S physics steps ``(K, S, nsensordata)``.
            gravity: direction of gravity ``(K, 3)`` [world] if the floor is not level.
            mass: total mass ``(K, 1)`` [kg] if it differs from world to world.
        """
        qpos, qvel, last = qpos.float(), qvel.float(), sensors[:, -1].float()
        orientation = qpos[:, 3:7].contiguous()
        out: dict[NestedKey, Tensor] = {
            "joint_position": qpos.index_select(1, self.qpos_index),
            "joint_velocity": qvel.index_select(1, self.qvel_index),
            "base_position": qpos[:, :3].contiguous(),
            "base_orientation": orientation,
            "projected_gravity": _gravity(orientation, gravity),
            "base_linear_velocity": qvel[:, :3].contiguous(),
            "base_angular_velocity": qvel[:, 3:6].contiguous(),
        }
        for key, (span, shape) in self._last.items():
            out[key] = last[:, span].reshape(-1, *shape).clone()
        out["linear_momentum"] = (self.mass if mass is None else mass) * out["com_velocity"]
        contact = last[:, self._contact].unflatten(
            -1, (self._num_feet, -1)
        )  # found, force of the foot on the floor, its center
        touching = contact[..., 0] > 0
        from_center = contact[..., 4:7] - out["feet_position"]
        center = rotate_inverse(out["feet_orientation"], from_center)[..., :2]
        out["feet_contact"] = touching
        out["feet_force"] = -contact[..., 1:4]
        # A sole can touch without a force, and then has no center: MuJoCo gives the world's origin.
        pressed = touching & (contact[..., 1:4] != 0.0).any(-1)
        out["feet_cop"] = torch.where(pressed[..., None], center, 0.0)
        out["feet_corner_force"] = -last.index_select(1, self._corners).unflatten(
            -1, (self._num_feet, -1)
        )
        return out | self._over_step(sensors)

    def _over_step(self, sensors: Tensor) -> dict[NestedKey, Tensor]:
        """What is averaged or peaked over the physics steps of ``sensors``."""
        torque = sensors[..., self._torque]
        vectors = sensors[..., self._vectors].float()
        norm = self._norms(vectors)
        peak = norm.amax(1)
        return {
            "joint_torque": torque.mean(1).float(),
            "joint_torque_peak": torque.abs().amax((1, 2)).unsqueeze(1).float(),
            "base_acceleration": vectors[..., self._acceleration].mean(1),
            "base_acceleration_peak": peak[:, -1:].contiguous(),
            "contact_force_peak": peak[:, :-1].contiguous(),
            "contact_impulse": norm[..., :-1].mean(1) * self._control_dt,
        }

    def _norms(self, vectors: Tensor) -> Tensor:
        """Norms of the force on each region and of the acceleration ``(K, S, R + 1)``."""
        x, y, z = (vectors @ self._sum).square_().chunk(3, -1)
        square = (x + y).add_(z)
        np.sqrt(square.numpy(), out=square.numpy())  # torch's takes 20 times as long for zeros
        return square

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
        read: dict[str, Callable[[], Tensor]] = {
            "joint_position": lambda: qpos.float().index_select(-1, self.qpos_index),
            "joint_velocity": lambda: qvel.float().index_select(-1, self.qvel_index),
            "joint_torque": lambda: sensors[..., self._torque],
            "base_position": lambda: qpos[..., :3],
            "base_orientation": lambda: qpos[..., 3:7],
            "projected_gravity": lambda: _gravity(
                qpos[..., 3:7].float(), None if gravity is None else gravity[:, None]
            ),
            "base_linear_velocity": lambda: qvel[..., :3],
            "base_angular_velocity": lambda: qvel[..., 3:6],
            "base_acceleration": lambda: sensors[..., self._vectors][..., self._acceleration],
        }
        return {key: read[key]().float() for key in keys}


def _span(columns: Tensor) -> slice | Tensor:
    """The columns, as a slice if they follow each other: a fraction of the time of an index."""
    columns = columns.flatten()
    first, last = int(columns.min()), int(columns.max())
    consecutive = columns.tolist() == list(range(first, last + 1))
    return slice(first, last + 1) if consecutive else columns


def _gravity(orientation: Tensor, gravity: Tensor | None) -> Tensor:
    """Direction of gravity in body axes; straight down in the world if ``None``."""
    return -up_axis(orientation) if gravity is None else rotate_inverse(orientation, gravity)
