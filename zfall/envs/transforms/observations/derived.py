"""Quantities that follow from others, for observations that need them so.

Each is worked out from the true values, and once more from the measured ones, as ``("measured",
key)``, if an earlier sensing transform measured one of those it follows from.
"""

from collections.abc import Callable, Mapping
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.on_robot import Derived, OnRobot
from zfall.envs.transforms.base_env import on_data
from zfall.envs.transforms.observations.measured import measured_key, read_measured
from zfall.rotations import rotate_inverse, turned, up_axis


def _write(
    tensordict: TensorDictBase, key: str, derive: Callable[..., Tensor], of: list[str]
) -> None:
    """Writes ``derive(*of)`` as ``key``, and of measured values if there is one among ``of``."""
    tensordict[key] = derive(*(tensordict[name] for name in of))
    if any(tensordict.get(measured_key(name), None) is not None for name in of):
        measured = (read_measured(tensordict, name) for name in of)
        tensordict[measured_key(key)] = derive(*measured)


def _declare(spec: Composite, key: str, shape: tuple[int, ...], of: list[str]) -> Composite:
    """Adds what ``_write`` writes to a spec."""
    there = spec.keys(True)
    keys = [key, measured_key(key)] if any(measured_key(n) in there for n in of) else [key]
    for name in keys:
        spec[name] = Unbounded((*spec.shape, *shape))
    return spec


class BasePose(Transform):
    """Height, roll and pitch of the base over the floor.

    Intrinsic rotations about z, x, y: ``roll = asin(u_y)`` about the axis forward and
    ``pitch = atan2(-u_x, u_z)`` about the axis to the left, with u the world's up axis in base
    axes. Positive to the right and forward.

    Keys: reads ``base_position`` ``(N, 3)`` [m] and ``base_orientation`` ``(N, 4)``; writes
    ``base_height`` ``(N, 1)`` [m] and ``roll_pitch`` ``(N, 2)`` [rad].

    Source: Ferigo et al., RA-L 2021, section III-A and table I.
    """

    measured = True
    forward = on_data

    def __init__(self) -> None:
        keys = ["base_position", "base_orientation"]
        super().__init__(in_keys=keys, out_keys=["base_height", "roll_pitch"])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        position, orientation = self.in_keys
        _write(next_tensordict, "base_height", lambda value: value[..., 2:], [position])
        _write(next_tensordict, "roll_pitch", roll_pitch, [orientation])
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def on_robot(self) -> OnRobot:
        """The same on a robot that is given what it reads."""
        functions = {
            "base_height": lambda p, q: p[..., 2:],
            "roll_pitch": lambda p, q: roll_pitch(q),
        }
        return Derived(self.in_keys, functions)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        position, orientation = self.in_keys
        _declare(observation_spec, "base_height", (1,), [position])
        return _declare(observation_spec, "roll_pitch", (2,), [orientation])


class FeetInBase(Transform):
    """Where the feet are seen from the base, and the weight on each.

    Keys: reads ``base_position``, ``base_orientation``, ``feet_position`` and ``feet_force``;
    writes ``feet_in_base`` ``(N, 2, 3)`` [m; base axes, from its origin] and ``feet_load``
    ``(N, 2)``, the vertical force of the floor on each foot [N].
    """

    measured = True
    forward = on_data

    def __init__(self) -> None:
        keys = ["base_position", "base_orientation", "feet_position", "feet_force"]
        super().__init__(in_keys=keys, out_keys=["feet_in_base", "feet_load"])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        *pose, force = self.in_keys
        _write(next_tensordict, "feet_in_base", feet_in_base, pose)
        _write(next_tensordict, "feet_load", lambda value: value[..., 2], [force])
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def on_robot(self) -> OnRobot:
        """The same on a robot that is given what it reads."""
        functions = {
            "feet_in_base": lambda *pose_force: feet_in_base(*pose_force[:3]),
            "feet_load": lambda *pose_force: pose_force[3][..., 2],
        }
        return Derived(self.in_keys, functions)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        *pose, force = self.in_keys
        _declare(observation_spec, "feet_in_base", (2, 3), pose)
        return _declare(observation_spec, "feet_load", (2,), [force])


class ImuOrientation(Transform):
    """The quaternion of an IMU's own filter: of the two that mean the same, that with w >= 0.

    Keys: reads ``base_orientation`` ``(N, 4)``, writes ``imu_orientation`` ``(N, 4)``,
    (w, x, y, z), base to world.
    """

    reads: ClassVar[tuple[str, ...]] = ("base_orientation",)
    units: ClassVar[Mapping[str, str]] = {"imu_orientation": "1, w x y z, w >= 0"}
    measured = True
    forward = on_data

    def __init__(self) -> None:
        super().__init__(in_keys=list(self.reads), out_keys=["imu_orientation"])

    @staticmethod
    def orientation(*read: Tensor) -> Tensor:
        """The quaternion ``(*B, 4)`` of what is read."""
        return positive_half(*read)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        _write(next_tensordict, "imu_orientation", self.orientation, self.in_keys)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def on_robot(self) -> OnRobot:
        """The same on a robot that is given what it reads."""
        return Derived(self.in_keys, {"imu_orientation": self.orientation})

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        return _declare(observation_spec, "imu_orientation", (4,), self.in_keys)


class OrientationToHeading(ImuOrientation):
    """The quaternion of an IMU, turned back by the heading that is commanded.

    A robot that heads where it shall has the yaw 0 in it: its policy need not know where north is.
    Of the two that mean the same, that with w >= 0, as ``ImuOrientation``.

    Keys: reads ``base_orientation`` ``(N, 4)`` and ``commanded_heading`` ``(N, 1)`` [rad], which
    ``Command`` writes; writes ``imu_orientation`` ``(N, 4)``, (w, x, y, z).
    """

    reads: ClassVar[tuple[str, ...]] = ("base_orientation", "commanded_heading")

    @staticmethod
    def orientation(*read: Tensor) -> Tensor:
        """The quaternion ``(*B, 4)`` of what is read."""
        return to_heading(*read)


def roll_pitch(orientation: Tensor) -> Tensor:
    """Roll and pitch ``(*B, 2)`` [rad] of a quaternion ``(*B, 4)``, see ``BasePose``."""
    x, y, z = up_axis(orientation).unbind(-1)
    return torch.stack([torch.asin(y.clamp(-1.0, 1.0)), torch.atan2(-x, z)], -1)


def feet_in_base(position: Tensor, orientation: Tensor, feet: Tensor) -> Tensor:
    """Positions ``(*B, 2, 3)`` in the axes of a base at ``(*B, 3)`` turned by ``(*B, 4)``."""
    away = feet - position.unsqueeze(-2)
    return rotate_inverse(orientation.unsqueeze(-2).expand(*away.shape[:-1], 4), away)


def positive_half(orientation: Tensor) -> Tensor:
    """The quaternion ``(*B, 4)`` or its negative, so that the first component is not negative."""
    return torch.where(orientation[..., :1] < 0, -orientation, orientation)


def to_heading(orientation: Tensor, heading: Tensor) -> Tensor:
    """The quaternion ``(*B, 4)`` after a turn by ``-heading`` ``(*B, 1)`` [rad], see
    ``OrientationToHeading``."""
    return positive_half(turned(orientation, -heading[..., 0]))
