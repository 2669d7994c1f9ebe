"""Physical parameters that may differ from world to world."""

import math
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torchrl.data import Composite, Unbounded

from zfall.robots import GRAVITY, Robot
from zfall.robots.servos import Servo
from zfall.simulation.model import push_point_bodies
from zfall.simulation.servo_fields import ServoFields

# What the physics can bear; parameters that are not named here may be any number.
RANGES = {
    "link_mass": (0.01, math.inf),
    "slope": (-math.pi / 4, math.pi / 4),
}  # gravity still pulls
RANGES |= dict.fromkeys(
    (
        *("payload", "floor_friction", "foot_friction", "joint_friction_loss", "joint_damping"),
        *("joint_armature", "servo_stiffness", "servo_torque_limit", "battery_voltage"),
        *("load_friction", "supply_resistance"),
    ),
    (0.0, math.inf),
)
ANY_NUMBER = (-math.inf, math.inf)
OF_DYNAMICS = ("load_friction", "supply_resistance")
OF_SERVOS = {"servo_stiffness", "servo_torque_limit", "battery_voltage", "joint_zero_offset"}

Array = NDArray[Any]


class PhysicsParameters:
    """The values of all worlds, and what they mean for fields of ``mjModel``.

    ==================== ======= ====================================================
    parameter            size    content, in brackets the nominal value
    ==================== ======= ====================================================
    link_mass            L       factor on mass and inertia of each of ``links`` (1)
    com_offset           3 L     shift of their centers of mass, link axes [m] (0)
    payload              P       point mass at each of ``push_points`` [kg] (0)
    floor_friction       1       sliding friction of all but the feet, on the floor (1)
    foot_friction        1       sliding friction of the feet (1)
    joint_friction_loss  J       factor on dry friction in the joints (1)
    joint_damping        J       factor on viscous damping (1)
    joint_armature       J       factor on the inertia of motors and gears (1)
    servo_stiffness      J       factor on torque per angle (1)
    servo_torque_limit   J       factor on the largest torque (1)
    battery_voltage      1       share of the nominal voltage: a factor on both (1)
    joint_zero_offset    J       what the encoder reads at angle 0 [rad] (0)
    slope                2       angle by which the floor falls along x and y [rad] (0)
    load_friction        J       factor on what load adds to the dry friction (1)
    supply_resistance    1       between the battery and all servos [Ohm] (0)
    ==================== ======= ====================================================

    The last two are there with ``servo_dynamics`` alone, see ``ServoDynamics``.

    On a slope gravity turns and the floor stays: heights and tilts are measured from the floor.

    Args:
        model: the compiled model, with the nominal values.
        robot: the robot.
        num_envs: number of worlds N.
        servos: those that the model was compiled with, if they are not the MJCF's.
        servo_dynamics: whether they have ``ServoDynamics``.

    Attributes:
        ranges: smallest and largest value of parameters, by name: ``RANGES``, and of the voltage
            what all servos bear.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        robot: Robot,
        num_envs: int,
        servos: Mapping[str, Servo] | None = None,
        servo_dynamics: bool = False,
    ):
        self._servos = servos
        self.ranges = RANGES | ({"battery_voltage": _voltages(servos)} if servos else {})
        self.push_points = push_point_bodies(model)
        soles = [int(model.sensor(f"feet_position/{foot}").objid[0]) for foot in robot.feet]
        feet = model.site_bodyid[soles]
        bodies = range(1, model.nbody)
        moving = [i for i in bodies if model.body_mass[i] > 0 and model.body(i).name != "ball"]
        self.links = [model.body(i).name for i in moving]
        self._link = np.array(moving)
        self._foot = np.flatnonzero(np.isin(model.geom_bodyid, feet))
        self._not_foot = np.flatnonzero(~np.isin(model.geom_bodyid, feet))
        joints = [model.joint(name) for name in robot.joints]
        self._dof = np.array([int(joint.dofadr[0]) for joint in joints])
        self._servo_fields = ServoFields(model, robot.joints)
        fields = (
            *("body_mass", "body_inertia", "body_ipos", "geom_friction"),
            *("dof_damping", "dof_armature"),
        )
        self._nominal = {name: getattr(model, name).copy() for name in fields}
        size, links = len(robot.joints), len(moving)
        ones = {"link_mass": links, "floor_friction": 1, "foot_friction": 1, "battery_voltage": 1}
        joint_factors = ("joint_friction_loss", "joint_damping", "joint_armature")
        ones |= dict.fromkeys((*joint_factors, "servo_stiffness", "servo_torque_limit"), size)
        zeros = {"com_offset": 3 * links, "payload": len(self.push_points)}
        zeros |= {"joint_zero_offset": size, "slope": 2}
        if servo_dynamics:
            ones["load_friction"], zeros["supply_resistance"] = size, 1
        self.values = {name: torch.ones(num_envs, width) for name, width in ones.items()}
        self._floor = np.float32(model.geom("floor").friction[0])  # nominal
        self.values["floor_friction"] *= float(self._floor)
        self.values["foot_friction"] *= float(model.geom_friction[self._foot[0], 0])
        self.values |= {name: torch.zeros(num_envs, width) for name, width in zeros.items()}
        self.gravity: Tensor | None = None  # its direction (N, 3) if any floor is not level
        self.mass: Tensor | None = None  # of the robots (N, 1) [kg] if any is not the nominal one
        shapes = {name: Unbounded(value.shape) for name, value in self.values.items()}
        self.spec = Composite(shapes, shape=(num_envs,))

    def update(self, values: Mapping[str, Tensor], rows: Tensor) -> dict[str, Array]:
        """Takes new values; returns the fields of ``mjModel`` ``(K, ...)`` that change with them.

        Args:
            values: parameters ``(N, size)`` by name.
            rows: which worlds take them ``(N,)`` bool.

        Raises:
            ValueError: on an unknown name, a wrong shape, or a value out of ``ranges``.
        """
        # A few rows of many small arrays, where NumPy takes a fraction of torch's time.
        index, changed = rows.nonzero()[:, 0], set()
        places = index.numpy()
        for name, value in values.items():
            if name in OF_DYNAMICS and name not in self.values:
                raise ValueError(
                    f"{name} must go with env.base_env.servo_dynamics=true, which needs servos."
                )
            if name not in self.values:
                raise ValueError(
                    f"physical parameters must be of {', '.join(self.values)}, got {name!r}."
                )
            if value.shape != self.values[name].shape:
                raise ValueError(
                    f"{name} must have the shape {tuple(self.values[name].shape)}, "
                    f"got {tuple(value.shape)}."
                )
            new, old = value.detach().float().numpy()[places], self.values[name]
            low, high = self.ranges.get(name, ANY_NUMBER)
            if new.size and not (low <= new.min() and new.max() <= high and np.isfinite(new).all()):
                sound = (new >= low) & (new <= high) & np.isfinite(new)
                raise ValueError(
                    f"{name} must be finite and within [{low:.3g}, {high:.3g}], "
                    f"got {new[~sound][0]:.3g}."
                )
            if name == "supply_resistance" and new.any():
                for servo in (self._servos or {}).values():
                    servo.need("stall_current")
            if not np.array_equal(new, old.numpy()[places]):
                changed.add(name)  # a new tensor: others may hold the old one
                self.values[name] = old.index_copy(0, index, torch.from_numpy(new))
        slope, payload = self.values["slope"], self.values["payload"]
        self.gravity = _downhill(slope) if slope.any() else None
        self.mass = None
        if payload.any() or (self.values["link_mass"] != 1.0).any():
            links = torch.from_numpy(self._nominal["body_mass"][self._link]).float()
            own = (links * self.values["link_mass"]).sum(-1, keepdim=True)
            self.mass = own + payload.sum(-1, keepdim=True)
        return self._fields(changed, places)

    def state_dict(self) -> dict[str, Tensor]:
        """All values, to ``update`` with."""
        return {name: value.clone() for name, value in self.values.items()}

    def _fields(self, names: set[str], rows: Array) -> dict[str, Array]:
        """Values ``(K, ...)`` of the fields that depend on any of ``names``, of worlds ``(K,)``."""
        fields: dict[str, Array] = {}

        def value(name: str) -> Array:
            return self.values[name].numpy()[rows].astype(np.float64)

        def nominal(name: str) -> Array:
            fields[name] = self._nominal[name][None].repeat(len(rows), 0)
            return fields[name]

        if names & {"link_mass", "payload"}:
            mass, inertia, factor = (
                nominal("body_mass"),
                nominal("body_inertia"),
                value("link_mass"),
            )
            mass[:, self._link] *= factor
            inertia[:, self._link] *= factor[..., None]
            mass[:, list(self.push_points.values())] = value("payload")
        if "com_offset" in names:
            shift = value("com_offset").reshape(len(rows), -1, 3)
            nominal("body_ipos")[:, self._link] += shift
        if names & {"floor_friction", "foot_friction"}:
            friction = nominal("geom_friction")
            floor = value("floor_friction")  # of all but the feet: the larger of two counts
            as_it_is = friction[:, self._not_foot, 0]
            friction[:, self._not_foot, 0] = np.where(floor == self._floor, as_it_is, floor)
            friction[:, self._foot, 0] = value("foot_friction")
        if "joint_friction_loss" in names:
            fields |= self._servo_fields.friction(value("joint_friction_loss"))
        for name, field in (("joint_damping", "dof_damping"), ("joint_armature", "dof_armature")):
            if name in names:
                nominal(field)[:, self._dof] *= value(name)
        if names & OF_SERVOS:
            voltage = value("battery_voltage")
            stiffness = value("servo_stiffness") * voltage
            limit = value("servo_torque_limit") * voltage
            fields |= self._servo_fields.actuators(stiffness, limit, value("joint_zero_offset"))
        if "slope" in names:
            fields["gravity"] = GRAVITY * _downhill(torch.from_numpy(value("slope"))).numpy()
        return fields


def _voltages(servos: Mapping[str, Servo]) -> tuple[float, float]:
    """Smallest and largest share of the nominal voltage that all servos work at."""
    shares = np.array([np.divide(each.voltage_range, each.voltage) for each in servos.values()])
    shares = shares.astype(np.float32)  # like the values
    return float(shares[:, 0].max()), float(shares[:, 1].min())


def _downhill(slope: Tensor) -> Tensor:
    """Direction of gravity ``(*B, 3)`` over a floor that falls by ``slope`` ``(*B, 2)`` [rad]."""
    level = torch.sin(slope)
    down = (1.0 - level.square().sum(-1, keepdim=True)).clamp_min(0.0).sqrt()
    return torch.cat([level, -down], -1)
