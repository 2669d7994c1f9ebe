"""From a robot's MJCF to the compiled model that an env steps."""

import hashlib
import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from zfall.robots import Ball, Contact, PushPoint, Robot, bare_model, full_spec, let_feet_decide
from zfall.robots.declared import check_declared
from zfall.robots.servos import Servo
from zfall.simulation.look import dress
from zfall.simulation.quantities import needed_sensors
from zfall.simulation.servos import put_servos

_POINT = "push_point/"  # prefix of the massless bodies that stand for push points
_PARKED = (1000.0, 0.0)  # where a ball waits on the floor, out of reach [m]


def compile_model(
    robot: Robot,
    *,
    physics_dt: float,
    push_points: dict[str, PushPoint] | None = None,
    ball: Ball | None = None,
    servos: Mapping[str, Servo] | None = None,
    contact: Contact | None = None,
    powered: bool = True,
    look: bool = False,
) -> mujoco.MjModel:
    """Compiles ``model_spec``.

    Args:
        robot, physics_dt, push_points, ball, servos, contact: see ``model_spec``.
        powered: whether the servos act at all; without power the robot is limp.
        look: whether to add what the robot looks like, for pictures; the state stays the same.

    Raises:
        ValueError: as ``model_spec``.
    """
    parts: dict[str, Any] = {"push_points": push_points, "ball": ball, "servos": servos}
    spec = model_spec(robot, physics_dt=physics_dt, contact=contact, look=look, **parts)
    if look:
        dress(spec, robot)
    model = spec.compile()
    if not powered:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    return model


def model_spec(
    robot: Robot,
    *,
    physics_dt: float,
    push_points: dict[str, PushPoint] | None = None,
    ball: Ball | None = None,
    servos: Mapping[str, Servo] | None = None,
    contact: Contact | None = None,
    look: bool = False,
) -> mujoco.MjSpec:
    """The robot's MJCF with a massless body welded to each push point.

    MuJoCo applies forces at the center of mass of a body. A body without mass that is fixed to
    a link at an offset makes a force there exact at every physics step, the torque included,
    and changes nothing else.

    Args:
        robot: the robot.
        physics_dt: timestep [s].
        push_points: points in addition to those of the robot, by name.
        ball: a free ball next to the robot, parked out of reach.
        servos: by joint, in place of the MJCF's actuators; those as they are if ``None``.
        contact: of all that touch; as the MJCF has it if ``None``.
        look: whether to keep what an MJCF has for pictures alone.

    Raises:
        ValueError: if the MJCF lacks a joint, an actuator or a sensor that the env needs, or is
            another than the robot declares, a push point names a link that does not exist, a joint
            has no servo, or a servo lacks a value.
    """
    spec = full_spec(robot)
    if look:  # before it is compiled, which takes out what is left out
        spec.compiler.discardvisual = False
    spec.option.timestep = physics_dt
    _check(spec, robot)
    check_declared(robot)
    if servos is not None:
        put_servos(spec, robot, servos)
    let_feet_decide(spec, robot)
    plain = spec.compile()
    for name, point in {**robot.push_points, **(push_points or {})}.items():
        if spec.body(name) is not None:
            raise ValueError(f"push_points.{name}: must not have the name of a link.")
        link, place = _place_of(spec, plain, name, point)
        body = link.add_body(name=_POINT + name, pos=place)
        # Forces act at the inertial frame: MuJoCo would put that of a body without mass elsewhere.
        body.explicitinertial, body.mass, body.ipos = True, 0.0, [0.0, 0.0, 0.0]
    if ball is not None:
        _add_ball(spec, ball)
    if contact is not None:
        for geom in spec.geoms:
            geom.solref = contact.solref(physics_dt)
    return spec


def physics_steps(control_dt: float, physics_dt: float) -> int:
    """Physics steps S in a control step.

    Raises:
        ValueError: if they are not a whole number, or a time is not positive and finite.
    """
    for name, value in (("physics_dt", physics_dt), ("control_dt", control_dt)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} must be positive and finite, got {value}.")
    substeps = round(control_dt / physics_dt)
    if substeps < 1 or abs(substeps * physics_dt - control_dt) > 1e-9:
        raise ValueError(
            f"control_dt must be a multiple of physics_dt, got control_dt {control_dt} with "
            f"physics_dt {physics_dt}; {max(substeps, 1) * physics_dt:g} would be."
        )
    return substeps


def push_targets(model: mujoco.MjModel) -> dict[str, int]:
    """Index in the ``bodies`` dimension of a wrench, of every push point and every link."""
    names = [model.body(i).name for i in range(1, model.nbody)]
    points = {name.removeprefix(_POINT): i for i, name in enumerate(names) if _POINT in name}
    return points | {name: i for i, name in enumerate(names) if _POINT not in name}


def find_push_target(targets: Mapping[str, int], point: str) -> int:
    """Index of a push point or link among ``push_targets``.

    Raises:
        ValueError: if there is none of this name.
    """
    if point not in targets:
        raise ValueError(
            f"point must be a push point or a link, one of {', '.join(targets)}; got {point!r}."
        )
    return targets[point]


def joint_range(model: mujoco.MjModel, robot: Robot) -> Tensor:
    """Of each joint ``(J, 2)`` float32 [rad]."""
    ranges = [model.joint(name).range for name in robot.joints]
    return torch.from_numpy(np.stack(ranges)).float()


def actuator_order(model: mujoco.MjModel, robot: Robot) -> slice | Tensor:
    """Joints in the order of the model's actuators; all as they are if it is the same."""
    order = [robot.joints.index(model.actuator(i).name) for i in range(model.nu)]
    return slice(None) if order == sorted(order) else torch.tensor(order)


def base_center_of_mass(model: mujoco.MjModel) -> Tensor:
    """Center of mass of the link that moves freely, in its own axes ``(3,)`` float32 [m]."""
    free = (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).nonzero()[0]
    return torch.from_numpy(model.body_ipos[model.jnt_bodyid[free[0]]]).float()


def push_point_bodies(model: mujoco.MjModel) -> dict[str, int]:
    """Index of the massless body of every push point, by name."""
    names = [model.body(i).name for i in range(model.nbody)]
    return {name.removeprefix(_POINT): i for i, name in enumerate(names) if _POINT in name}


def sensor_slices(model: mujoco.MjModel) -> dict[str, slice]:
    """Where each sensor's values lie in ``sensordata``, by name."""
    return {
        model.sensor(i).name: slice(adr, adr + dim)
        for i, (adr, dim) in enumerate(zip(model.sensor_adr, model.sensor_dim, strict=True))
    }


def _add_ball(spec: mujoco.MjSpec, ball: Ball) -> None:
    """Adds the ball after the robot, so that the robot's indices stay; raises ``ValueError``."""
    for name, value in (("mass", ball.mass), ("radius", ball.radius)):
        if not value > 0:
            raise ValueError(f"ball.{name} must be positive, got {value}.")
    place = [*_PARKED, ball.radius]
    body = spec.worldbody.add_body(name="ball", pos=place)
    body.add_freejoint(name="ball")
    body.add_geom(
        name="ball",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[ball.radius, 0.0, 0.0],
        mass=ball.mass,
        contype=1,  # it meets the floor and every part of the robot
        conaffinity=1,
        rgba=[0.9, 0.35, 0.2, 1.0],
    )
    for key in spec.keys:
        key.qpos = np.concatenate([key.qpos, place, [1.0, 0.0, 0.0, 0.0]])


def _place_of(
    spec: mujoco.MjSpec, model: mujoco.MjModel, name: str, point: PushPoint
) -> tuple[mujoco.MjsBody, list[float]]:
    """The link of a push point and its position in that link's frame [m].

    An offset is given in the root link's axes. Raises ``ValueError`` on what does not exist.
    """
    if (point.body is None) == (point.site is None):
        raise ValueError(f"push_points.{name}: give just one of body and site.")
    if point.site is not None:
        if any(point.offset or ()):
            raise ValueError(f"push_points.{name}: offset must go with a body, not with a site.")
        site = spec.site(point.site)
        if site is None:
            there = ", ".join(site.name for site in spec.sites if site.name)
            raise ValueError(
                f"push_points.{name}: site must be one of {there}, got {point.site!r}."
            )
        return site.parent, list(site.pos)
    links = [body.name for body in spec.bodies if body.name != "world"]
    if point.body not in links:
        raise ValueError(
            f"push_points.{name}: body must be one of {', '.join(links)}, got {point.body!r}."
        )
    link = spec.body(point.body)
    if point.offset is None:
        return link, [0.0, 0.0, 0.0]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)  # at qpos0 the root link's axes are those of the world
    axes = data.body(point.body).xmat.reshape(3, 3)
    return link, list(model.body(point.body).ipos + axes.T @ point.offset)


def _check(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Raises if the MJCF lacks something the env needs, naming all that it lacks."""
    sensors = {sensor.name for sensor in spec.sensors}
    lacking = sorted(needed_sensors(robot).keys() - sensors)
    lacking += [
        f"contact_force_peak/{region}"
        for region in robot.regions
        if not any(name_in_region(name, region) for name in sensors)
    ]
    if lacking:
        raise ValueError(
            f"{robot.mjcf} must have a sensor for every key, lacks {', '.join(lacking)}."
        )
    for kind, named in (("joint", spec.joints), ("actuator", spec.actuators)):
        missing = sorted(set(robot.joints) - {x.name for x in named})
        if missing:
            raise ValueError(
                f"{robot.mjcf} must have the joints and actuators of robot.joints, "
                f"lacks the {kind} {', '.join(missing)}."
            )
    more = sorted({x.name for x in spec.actuators} - set(robot.joints))
    if more:
        raise ValueError(
            f"{robot.mjcf} must have an actuator for each of robot.joints alone, also has "
            f"{', '.join(more)}."
        )
    if spec.key("stand") is None:
        raise ValueError(f"{robot.mjcf} must have a keyframe named 'stand'.")


def name_in_region(sensor: str, region: str) -> bool:
    """Whether a contact sensor belongs to a region: ``contact_force_peak/REGION[/PART]``."""
    return sensor.split("/")[:2] == ["contact_force_peak", region]


def servo_time_constant(model: mujoco.MjModel, robot: Robot) -> Tensor:
    """Damping over stiffness of each joint with its servo ``(J,)`` [s], as compiled."""
    joints = [(model.joint(name), model.actuator(name)) for name in robot.joints]
    return torch.tensor([float((j.damping[0] - a.biasprm[2]) / -a.biasprm[1]) for j, a in joints])


FIELDS = (  # what makes a robot move and sense as it does
    *("body_mass", "body_inertia", "body_pos", "body_quat", "body_ipos", "body_iquat"),
    *("body_parentid", "jnt_type", "jnt_pos", "jnt_axis", "jnt_range", "jnt_stiffness"),
    *("dof_damping", "dof_armature", "dof_frictionloss", "actuator_gear", "actuator_trnid"),
    *("actuator_gainprm", "actuator_biasprm", "actuator_ctrlrange", "actuator_forcerange"),
    *("geom_type", "geom_bodyid", "geom_size", "geom_pos", "geom_quat", "geom_friction"),
    *("geom_priority", "geom_condim", "geom_contype", "geom_conaffinity", "geom_solref"),
    *("geom_solimp", "geom_margin", "site_bodyid", "site_pos", "site_quat"),
)
OPTIONS = ("gravity", "wind", "density", "viscosity", "integrator", "cone", "impratio")


def identity_of(robot: Robot) -> str:
    """Name of a robot and a digest of its compiled physics: comments and poses may change."""
    return _identity(robot)


@cache
def _identity(robot: Robot) -> str:
    model = bare_model(robot)
    values = [getattr(model, field) for field in FIELDS]
    values += [getattr(model.opt, option) for option in OPTIONS]
    # Some seven digits: the last ones, and the sign of 0, may differ between machines.
    known = b"".join((np.round(v, 12).astype(np.float32) + 0.0).tobytes() for v in values)
    return f"{robot.name} {hashlib.sha256(known).hexdigest()[:8]}"
