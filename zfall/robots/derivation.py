"""What an MJCF says of a robot: everything that nobody has to type next to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from zfall.robots import anatomy
from zfall.robots.actuators import actuated_joints
from zfall.robots.completion import STAND, Additions, complete
from zfall.robots.geometry import Sole, sole_of
from zfall.robots.mjcf import compile_spec, plain_model, read_spec
from zfall.robots.points import PushPoint
from zfall.robots.refusals import (
    GRAVITY,
    check_base,
    check_feet,
    check_gravity,
    check_joints,
    check_regions,
    check_stand,
    check_stiffness,
)
from zfall.robots.symmetry import find_symmetry

if TYPE_CHECKING:
    from zfall.robots.robot import Robot

Array = NDArray[np.float64]
_READ = ("mjcf", "joints", "stand", "keyframe", "feet", "foot_links", "region_links", "stiffness",
         "held")  # fmt: skip

SETTLING = 20.0  # time for which the servos must hold the reference pose, in units of sqrt(h0 / g)
FALLEN, LEANS = 0.8, 0.35  # share of the height, and tilt [rad], beyond which they do not
_DT = 0.002  # of the settling, or the MJCF's own if that is shorter [s]
_NUDGE = 0.02  # speed forward and to the left with which it begins, in units of sqrt(g h0)
_UNEQUAL = 0.1  # share by which the soles may differ in size


@dataclass(frozen=True)
class Derived:
    """Of a robot, see the arguments of ``Robot`` of the same names; and what its MJCF lacks."""

    additions: Additions
    joints: tuple[str, ...]
    stand: dict[str, float]
    keyframe: str | None
    sole_half_size: tuple[float, float]
    regions: tuple[str, ...]
    push_points: dict[str, PushPoint]
    legs: tuple[str, ...]
    mirror: dict[str, str]
    mirror_signs: tuple[float, ...]
    com_height: float
    mass: float


_known: dict[str, Derived] = {}  # by what is declared: it takes seconds where there are meshes


def derive(robot: "Robot") -> Derived:
    """Everything about a robot that its MJCF and what is declared say; worked out once.

    Raises:
        ValueError: if the MJCF is no humanoid on a free joint, or its reference pose falls.
    """
    written = Path(robot.mjcf).stat().st_mtime_ns
    declared = f"{written} {[getattr(robot, name) for name in _READ]}"
    try:
        if declared not in _known:
            _known[declared] = _derive(robot)
        return _known[declared]
    except ValueError as error:
        text = str(error)
        raise ValueError(text if text.startswith("mjcf ") else f"{robot.mjcf}: {text}.") from None


def _derive(robot: "Robot") -> Derived:
    spec, model = read_spec(robot.mjcf), plain_model(robot.mjcf)
    check_base(model)
    check_gravity(model)
    joints = tuple(robot.joints or actuated_joints(model))
    check_joints(model, joints)
    check_stiffness(robot.stiffness, joints)
    stand, tilt = _reference(model, joints, robot)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    data.qpos[:7] = [0, 0, 0, *tilt]
    for joint, angle in stand.items():
        data.qpos[model.joint(joint).qposadr[0]] = angle
    _forward(model, data)
    feet = _feet(model, data, robot.foot_links)
    bodies = [anatomy.subtree(model, foot) for foot in feet]
    soles = (sole_of(model, data, bodies[0]), sole_of(model, data, bodies[1]))
    half = _half_size(soles)
    ground = min(_lowest(data, model, sole) for sole in soles)
    base = (0.0, 0.0, -ground, *map(float, tilt))
    mass, height = float(model.body_mass.sum()), float(data.subtree_com[1, 2] - ground)
    legs = [
        model.joint(joint).name for foot in feet for joint in anatomy.leg_joints(model, feet, foot)
    ]
    additions = Additions(
        root=model.body(1).name,
        joints=joints,
        angles=stand,
        base=base,
        soles=soles,
        toes=any(len(each) > 1 for each in bodies),
        regions=_regions(model, data, feet, robot.region_links),
        upright=dict.fromkeys(legs, mass * GRAVITY * height),
        height=height,
    )
    complete(spec, robot, additions)
    whole = compile_spec(spec, robot.mjcf)
    mirror = find_symmetry(whole, joints)
    return Derived(
        additions=additions,
        joints=joints,
        stand={joint: stand[joint] for joint in joints if stand.get(joint)},
        keyframe=_keyframe(robot, [model.key(n).name for n in range(model.nkey)]),
        sole_half_size=half,
        regions=tuple(additions.regions),
        push_points=_push_points(model, feet),
        legs=tuple(joint for joint in joints if joint in legs),
        mirror={}
        if mirror is None
        else {j: joints[i] for j, i in zip(joints, mirror.partner, strict=True)},
        mirror_signs=() if mirror is None else mirror.sign,
        com_height=settled_height(whole) if robot.held else height,
        mass=mass,
    )


def settled_height(model: mujoco.MjModel) -> float:
    """Height of the center of mass once the servos hold the keyframe ``stand`` at rest [m].

    Raises:
        ValueError: if the robot falls, or its physics fails.
    """
    data, before = mujoco.MjData(model), model.opt.timestep
    model.opt.timestep = min(before, _DT)
    mujoco.mj_resetDataKeyframe(model, data, model.key(STAND).id)
    mujoco.mj_forward(model, data)
    first = float(data.subtree_com[1, 2])
    data.qvel[:2] = _NUDGE * (GRAVITY * max(first, 1e-3)) ** 0.5  # what only balances falls then
    seconds = SETTLING * (max(first, 1e-3) / GRAVITY) ** 0.5
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    model.opt.timestep = before
    height, q = float(data.subtree_com[1, 2]), data.qpos[3:7]
    lean = float(np.arccos(np.clip(1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2), -1.0, 1.0)))
    if not (np.isfinite(height) and height > FALLEN * first and lean < LEANS):
        raise ValueError(
            f"the servos must hold the reference pose, it falls: after {seconds:.1f} s the center "
            f"of mass is at {height:.2f} m of {first:.2f} m and the base leans by {lean:.2f} rad; "
            "give another stand or keyframe, or another stiffness; held: false if that is meant"
        )
    return height


def _reference(
    model: mujoco.MjModel, joints: Sequence[str], robot: "Robot"
) -> tuple[dict[str, float], Array]:
    """Angles of all hinges in the reference pose [rad], and how the base leans."""
    hinges = [
        model.joint(number)
        for number in range(model.njnt)
        if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_HINGE and model.joint(number).name
    ]
    names = [model.key(number).name for number in range(model.nkey)]
    wanted = _keyframe(robot, names)
    if wanted is None:
        qpos = model.qpos0.copy()
        qpos[3:7] = [1.0, 0.0, 0.0, 0.0]
    else:
        qpos = model.key(names.index(wanted)).qpos
    angles = {hinge.name: float(qpos[hinge.qposadr[0]]) for hinge in hinges}
    stand = robot.stand or {}
    if unknown := [joint for joint in stand if joint not in angles]:
        raise ValueError(f"stand must name joints, there is no {unknown[0]}")
    check_stand(model, stand)
    if robot.stand is not None:
        angles |= dict.fromkeys(joints, 0.0)
    angles |= {name: float(angle) for name, angle in stand.items()}
    return angles, _facing_forward(qpos[3:7] / np.linalg.norm(qpos[3:7]))


def _facing_forward(base: Array) -> Array:
    """An orientation without its turn about the vertical: it leans as before, facing along x."""
    w, x, y, z = base
    yaw = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    if yaw == 0.0:
        return base
    found = np.zeros(4)
    mujoco.mju_mulQuat(found, np.array([np.cos(yaw / 2), 0.0, 0.0, -np.sin(yaw / 2)]), base)
    return found


def _keyframe(robot: "Robot", names: Sequence[str]) -> str | None:
    """Name of the keyframe with the reference pose, ``None`` without one."""
    if robot.keyframe is None:
        if robot.stand is not None or not names:
            return None
        return next((name for name in ("stand", "home") if name in names), names[0])
    if robot.keyframe not in names:
        there = ", ".join(names) or "none"
        raise ValueError(f"keyframe must be one of {there}, got {robot.keyframe}")
    return robot.keyframe


def _forward(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)


def _feet(
    model: mujoco.MjModel, data: mujoco.MjData, links: tuple[str, str] | None
) -> tuple[int, int]:
    if links is None:
        return anatomy.find_feet(model, data)
    check_feet(model, data, links)
    return int(model.body(links[0]).id), int(model.body(links[1]).id)


def _half_size(soles: Sequence[Sole]) -> tuple[float, float]:
    left, right = (np.array(sole.half_size) for sole in soles)
    if (abs(left - right) > _UNEQUAL * np.maximum(left, right) + 1e-3).any():
        raise ValueError(f"both soles must have the same size, they have {left} and {right} m")
    return float((left + right)[0] / 2), float((left + right)[1] / 2)


def _lowest(data: mujoco.MjData, model: mujoco.MjModel, sole: Sole) -> float:
    """Height of the lowest corner of a sole [m]."""
    link, turn, axes = data.body(sole.link), np.zeros(9), np.zeros(4)
    mujoco.mju_mulQuat(axes, link.xquat, sole.quaternion)
    mujoco.mju_quat2Mat(turn, axes)
    center = link.xpos + link.xmat.reshape(3, 3) @ sole.position
    return float(center[2] - abs(turn.reshape(3, 3)[2, :2]) @ np.array(sole.half_size))


def _regions(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    feet: tuple[int, int],
    declared: Mapping[str, Sequence[str]] | None,
) -> dict[str, tuple[str, ...]]:
    """Links by region, the feet last."""
    if declared is None:
        found = anatomy.find_regions(model, data, feet)
        return {name: tuple(model.body(b).name for b in ids) for name, ids in found.items()}
    check_regions(model, feet, declared)
    return {name: tuple(links) for name, links in declared.items()}


def _push_points(model: mujoco.MjModel, feet: tuple[int, int]) -> dict[str, PushPoint]:
    """At centers of mass: ``torso`` and ``chest`` of the trunk, ``pelvis`` of the legs' bearer.

    A link that has such a name is the point itself.
    """
    trunk = model.body(anatomy.trunk(model, feet)).name
    hips = model.body(anatomy.pelvis(model, feet)).name
    middle = PushPoint(body=trunk)
    points = {"torso": middle, "pelvis": PushPoint(body=hips), "chest": middle}
    links = {model.body(number).name for number in range(model.nbody)}
    return {name: point for name, point in points.items() if name not in links}
