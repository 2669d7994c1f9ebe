"""The quantities that the base env writes: one table, and the specs that follow from it.

A new quantity is one row of ``QUANTITIES`` and its formula in ``compiled.read_out``.
"""

from collections.abc import Iterable
from typing import Literal, NamedTuple

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded

from zfall.robots import Robot

# When the value is, see ``Quantity.age``.
END = "end of the step"  # of joints and base, from the state
OLD = "one physics step old"  # MuJoCo's sensors describe the state before the last integration
LAST = "last physics step"
MEAN = "mean over the step"
PEAK = "peak over the step"


class Place(NamedTuple):
    """Where a component of the state lies: in which of MuJoCo's arrays, and in which columns.

    ``None`` stands for the columns of the joints.
    """

    array: Literal["qpos", "qvel"]
    columns: slice | None = None


class Quantity(NamedTuple):
    """A measured quantity.

    Attributes:
        name: its key.
        shape: of one world; ``J`` joints, ``R`` regions, ``C`` corners of a sole.
        unit: with the axes of a vector.
        content: what it is.
        age: what of the control step it describes.
        place: where it lies in the state, if it is a component of the state.
        substeps: whether it is also known after each physics step.
        dtype: float32 or bool.
    """

    name: NestedKey
    shape: tuple[int | str, ...]
    unit: str
    content: str
    age: str
    place: Place | None = None
    substeps: bool = False
    dtype: torch.dtype = torch.float32

    def size(self, robot: Robot) -> tuple[int, ...]:
        """The shape for a robot."""
        sizes = {"J": len(robot.joints), "R": len(robot.regions), "C": len(robot.corners)}
        return tuple(sizes[n] if isinstance(n, str) else n for n in self.shape)


_QPOS, _QVEL = Place("qpos"), Place("qvel")
_POSITION, _ORIENTATION = Place("qpos", slice(0, 3)), Place("qpos", slice(3, 7))
_LINEAR, _ANGULAR = Place("qvel", slice(0, 3)), Place("qvel", slice(3, 6))
_QUATERNION, _MOMENTUM = "1, w x y z", "kg m2/s, world axes"
_GYRO, _ACCELEROMETER = "the gyro", "the accelerometer"
_NORM = "largest norm of the accelerometer, 9.81 at rest"

QUANTITIES = (
    Quantity("joint_position", ("J",), "rad", "joint angles", END, _QPOS, True),
    Quantity("joint_velocity", ("J",), "rad/s", "joint speeds", END, _QVEL, True),
    Quantity("joint_torque", ("J",), "N m", "torque of the servos", MEAN, None, True),
    Quantity("joint_torque_peak", (1,), "N m", "largest of any joint", PEAK),
    Quantity("base_position", (3,), "m, world axes", "origin of the base", END, _POSITION, True),
    Quantity("base_orientation", (4,), _QUATERNION, "base to world", END, _ORIENTATION, True),
    Quantity("projected_gravity", (3,), "1, base axes", "direction of gravity", END, None, True),
    Quantity("base_linear_velocity", (3,), "m/s, world axes", "of the base", END, _LINEAR, True),
    Quantity("base_angular_velocity", (3,), "rad/s, base axes", _GYRO, END, _ANGULAR, True),
    Quantity("base_acceleration", (3,), "m/s2, base axes", _ACCELEROMETER, MEAN, None, True),
    Quantity("base_acceleration_peak", (1,), "m/s2", _NORM, PEAK),
    Quantity("com_position", (3,), "m, world axes", "center of mass", OLD),
    Quantity("com_velocity", (3,), "m/s, world axes", "of the center of mass", OLD),
    Quantity("linear_momentum", (3,), "kg m/s, world axes", "mass x `com_velocity`", OLD),
    Quantity("angular_momentum", (3,), _MOMENTUM, "about the center of mass", OLD),
    Quantity("feet_position", (2, 3), "m, world axes", "center of each sole", OLD),
    Quantity("feet_orientation", (2, 4), _QUATERNION, "sole to world", OLD),
    Quantity("feet_velocity", (2, 3), "m/s, world axes", "of the center of each sole", OLD),
    Quantity("feet_contact", (2,), "0 or 1", "bool: a foot touches the floor", LAST,
             dtype=torch.bool),
    Quantity("feet_force", (2, 3), "N, world axes", "force of the floor on each foot", LAST),
    Quantity("feet_cop", (2, 2), "m, sole axes", "center of pressure, 0 without force", LAST),
    Quantity("feet_corner_force", (2, "C"), "N", "vertical force at each corner", LAST),
    Quantity("contact_force_peak", ("R",), "N", "norm of the floor's force on a region", PEAK),
    Quantity("contact_impulse", ("R",), "N s", "that norm, integrated", "sum over the step"),
)  # fmt: skip
FAILED = "bool: the physics failed or a value was not finite, which ends the episode"
FLAG = Quantity("diverged", (1,), "0 or 1", FAILED, "whole step", dtype=torch.bool)
BALL = (
    Quantity(("ball", "position"), (3,), "m, world axes", "center of the ball, if any", END),
    Quantity(("ball", "velocity"), (3,), "m/s, world axes", "of its center", END),
)
SERVOS = (  # with ``servo_dynamics``
    Quantity("battery_voltage", (1,), "V", "of the battery without load", END),
    Quantity("supply_voltage", (1,), "V", "what servos have of it in the coming step", END),
    Quantity("servo_temperature", ("J",), "deg C", "windings, if their constants are known", END),
)

NAMES = tuple(str(quantity.name) for quantity in QUANTITIES)
UNITS = {str(quantity.name): quantity.unit for quantity in QUANTITIES}
PLACES = {str(q.name): q.place for q in QUANTITIES if q.place is not None}
STATE_KEYS = tuple(PLACES)  # what a state of the robot is made of
SUBSTEP_KEYS = tuple(str(q.name) for q in QUANTITIES if q.substeps)
# Largest values over the physics steps: with the last step's they bound all that is observed, but
# for states amid the step, which stay there once they are beyond any physics.
PEAK_KEYS = tuple(str(q.name) for q in QUANTITIES if q.age == PEAK)


def needed_sensors(robot: Robot) -> dict[str, int]:
    """Names of the MJCF's sensors that the quantities are read from, with their sizes.

    Those of the regions come in addition, under ``contact_force_peak/REGION[/PART]``, 3 each.
    """
    names = ("base_acceleration", "com_position", "com_velocity", "angular_momentum")
    sizes = dict.fromkeys(names, 3) | {f"joint_torque/{joint}": 1 for joint in robot.joints}
    of_foot = {"feet_position": 3, "feet_orientation": 4, "feet_velocity": 3, "feet_contact": 7}
    for foot in robot.feet:
        sizes |= {f"{name}/{foot}": size for name, size in of_foot.items()}
        sizes |= {f"feet_corner_force/{foot}/{corner}": 3 for corner in robot.corners}
    return sizes


def observation_spec(robot: Robot, num_envs: int, more: Iterable[Quantity] = ()) -> Composite:
    """Of all quantities ``(N, ...)``, and of ``more``."""
    spec = Composite(shape=(num_envs,))
    for quantity in (*QUANTITIES, FLAG, *more):
        shape = (num_envs, *quantity.size(robot))
        flag = quantity.dtype == torch.bool
        spec[quantity.name] = (
            Binary(shape[-1], shape=shape, dtype=torch.bool) if flag else Unbounded(shape)
        )
    return spec


def with_substeps(spec: Composite, keys: Iterable[str], substeps: int) -> Composite:
    """A spec that also has ``("substeps", key)`` ``(N, S, ...)`` of some of its keys."""
    spec = spec.clone()
    for key in keys:
        num, *shape = spec[key].shape
        spec["substeps", key] = Unbounded((num, substeps, *shape))
    return spec


def action_spec(joint_range: Tensor, num_envs: int, substeps: int) -> Composite:
    """Of servo targets for each physics step, bounded by the joint ranges ``(J, 2)`` [rad]."""
    low, high = joint_range.unbind(-1)
    steps = torch.Size((num_envs, substeps, len(joint_range)))
    control = Bounded(low.expand(steps).clone(), high.expand(steps).clone(), steps)
    return Composite(control=control, shape=(num_envs,))


def done_spec(num_envs: int) -> Composite:
    """Of the flags that end an episode."""
    flags = ("done", "terminated", "truncated")
    return Composite(
        {key: Binary(1, shape=(num_envs, 1), dtype=torch.bool) for key in flags}, shape=(num_envs,)
    )


def markdown_table(quantities: Iterable[Quantity] = (*QUANTITIES, FLAG, *BALL, *SERVOS)) -> str:
    """The table of ``docs/reference/quantities.md``."""
    rows = [("key", "shape", "unit", "content", "age"), ("---",) * 5]
    for q in quantities:
        name = q.name if isinstance(q.name, str) else str(q.name).replace("'", '"')
        shape = " x ".join(map(str, q.shape))
        rows.append((f"`{name}`", shape, q.unit, q.content, q.age))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)
