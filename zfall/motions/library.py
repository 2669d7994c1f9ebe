"""Reference motions of the whole robot: standing, and walks made from pendulum gaits."""

from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from zfall.arrays import arrays_of
from zfall.motions.gaits import Gait, Times, center_of_mass, feet
from zfall.robots import DEFAULT, Robot, bare_model
from zfall.simulation.quantities import STATE_KEYS
from zfall.simulation.stance import stance

PHASES = 60  # stored of each stride
_CROUCH = 0.96  # of the standing height: a leg that is stretched cannot walk
_PRECISION, _ITERATIONS = 1e-10, 30  # of Newton's method [m, rad]

States = dict[str, NDArray[np.floating]]


class Motion(NamedTuple):
    """States that follow each other at equal times and then repeat.

    period: of the motion [s], 0 for a rest.
    states: by name, one of ``STATE_KEYS``, values ``(K, ...)`` float32.
    """

    period: float
    states: States


def gaits_of(robot: Robot) -> dict[str, Gait]:
    """The gaits that a robot declares, by name; else those of the default robot at its size.

    Lengths go with the height of the center of mass h, times with its square root. The feet are as
    far apart as in the reference pose.
    """
    if robot.gaits:
        return {name: Gait(**values) for name, values in robot.gaits.items()}
    longer = robot.com_height / DEFAULT.com_height
    later, width = longer**0.5, abs(float(stance(robot).feet_offset[1])) / 2
    return {
        name: Gait(
            speed=gait.speed * longer / later,
            turn_rate=gait.turn_rate / later,
            step_time=gait.step_time * later,
            double_support=gait.double_support * later,
            half_width=width,
            lift=gait.lift * longer,
            com_height=_CROUCH * robot.com_height,
        )
        for name, gait in gaits_of(DEFAULT).items()
    }


def make_motions(robot: Robot, gaits: Mapping[str, Gait]) -> dict[str, Motion]:
    """The standing pose at rest, ``standing``, and walks, ``PHASES`` states of a stride each."""
    motions = {"standing": Motion(0.0, standing(robot))}
    for name, gait in gaits.items():
        begin, end = gait.stride
        time = begin + (end - begin) / PHASES * np.arange(PHASES)
        motions[name] = Motion(end - begin, walk(robot, gait, time))
    return motions


def standing(robot: Robot) -> States:
    """The standing reference pose at rest, one state."""
    model = bare_model(robot)
    return _states(robot, model, model.key("stand").qpos[None], np.zeros((1, model.nv)))


def walk(robot: Robot, gait: Gait, time: Times) -> States:
    """States of the robot at times of a stride, of names ``STATE_KEYS`` ``(T, ...)`` float64.

    The trunk is upright and heads along the line, the arms keep the standing pose. Joints of the
    legs and position of the base follow from the poses of both soles and the position of the
    robot's center of mass, 15 equations, by Newton's method on MuJoCo's kinematics; velocities
    from the same Jacobian J by ``J v = (velocities of soles and center of mass)``.

    Raises:
        ValueError: if the legs do not reach so far, or a joint would leave its range.
    """
    model = bare_model(robot)
    data = mujoco.MjData(model)
    soles = [int(model.sensor_objid[model.sensor(f"feet_position/{f}").id]) for f in robot.feet]
    legs = [_leg(model, sole) for sole in soles]
    shared = {*legs[0]} & {*legs[1]}  # of a waist above both
    moving = np.array([0, 1, 2, *(dof for leg in legs for dof in leg if dof not in shared)])
    if len(moving) != 15:
        raise ValueError(f"legs must have six joints each to walk, {robot.name} has others.")
    soles_to, center = feet(gait, time), center_of_mass(gait, time)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    data.qpos[:2] = center.position[0].real, center.position[0].imag
    qpos, qvel = np.empty((len(time), model.nq)), np.zeros((len(time), model.nv))
    for k in range(len(time)):
        data.qpos[3:7] = _upright(gait.turn_rate * time[k])
        com = np.array([center.position[k].real, center.position[k].imag, gait.com_height])
        aims = list(zip(soles, soles_to.position[k], soles_to.heading[k], strict=True))
        jacobian = _solve(model, data, moving, aims, com, gait)
        rates = np.zeros(15)
        rates[[0, 1, 2, 6, 7, 8]] = soles_to.velocity[k].ravel()
        rates[[5, 11]] = soles_to.turn_rate[k]
        rates[12:14] = center.velocity[k].real, center.velocity[k].imag
        qvel[k, 5] = gait.turn_rate
        qvel[k, moving] = np.linalg.solve(jacobian[:, moving], rates - jacobian @ qvel[k])
        qpos[k] = data.qpos
    joints = model.dof_jntid[moving[3:]]
    angles, (low, high) = qpos[:, model.jnt_qposadr[joints]], model.jnt_range[joints].T
    outside = ((angles < low) | (angles > high)).any(0)
    if outside.any():
        name = model.joint(joints[outside][0]).name
        raise ValueError(f"gait must keep {name} in its range, got {gait}.")
    return _states(robot, model, qpos, qvel)


def _solve(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    moving: NDArray[np.int64],
    aims: list[tuple[int, NDArray[np.float64], float]],
    com: NDArray[np.float64],
    gait: Gait,
) -> NDArray[np.float64]:
    """Moves the degrees of freedom ``moving`` until soles and center of mass are in place.

    Returns the Jacobian there ``(15, nv)``: of each sole's position and rotation, of the center
    of mass.
    """
    for _ in range(_ITERATIONS):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        jacobian, error = np.zeros((15, model.nv)), np.zeros(15)
        for row, (sole, position, heading) in zip((0, 6), aims, strict=True):
            shift, turn = jacobian[row : row + 3], jacobian[row + 3 : row + 6]
            mujoco.mj_jacSite(model, data, shift, turn, sole)
            error[row : row + 3] = position - data.site_xpos[sole]
            error[row + 3 : row + 6] = _rotation_to(data.site_xmat[sole], _upright(heading))
        mujoco.mj_jacSubtreeCom(model, data, jacobian[12:], 1)
        error[12:] = com - data.subtree_com[1]
        if np.abs(error).max() < _PRECISION:
            return jacobian
        step = np.zeros(model.nv)
        try:
            step[moving] = np.linalg.solve(jacobian[:, moving], error)
        except np.linalg.LinAlgError:  # a leg is stretched
            break
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    raise ValueError(f"gait must be within reach of the legs, got {gait}.")


def _leg(model: mujoco.MjModel, sole: int) -> list[int]:
    """Degrees of freedom between the base and a sole."""
    dofs: list[int] = []
    body = model.site_bodyid[sole]
    while model.body_parentid[body] != 0:
        dofs += range(model.body_dofadr[body], model.body_dofadr[body] + model.body_dofnum[body])
        body = model.body_parentid[body]
    return dofs


def _upright(heading: float) -> NDArray[np.float64]:
    return np.array([np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)])


def _rotation_to(
    matrix: NDArray[np.float64], quaternion: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Rotation vector from one orientation to the other [rad; world axes]."""
    have, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(have, matrix)
    mujoco.mju_subQuat(vector, quaternion, have)
    return matrix.reshape(3, 3) @ vector


def _states(
    robot: Robot, model: mujoco.MjModel, qpos: NDArray[np.float64], qvel: NDArray[np.float64]
) -> States:
    joints = [model.joint(name) for name in robot.joints]
    parts = (
        qpos[:, [int(joint.qposadr[0]) for joint in joints]],
        qvel[:, [int(joint.dofadr[0]) for joint in joints]],
        *(qpos[:, :3], qpos[:, 3:7], qvel[:, :3], qvel[:, 3:6]),
    )
    return dict(zip(STATE_KEYS, parts, strict=True))


def motions_file(robot: Robot) -> Path:
    """Where a robot's motions are stored, next to its MJCF."""
    return Path(robot.mjcf).with_name(f"{robot.name}_motions.npz")


def save_motions(motions: dict[str, Motion], path: Path) -> None:
    """Writes motions in a row, float32."""
    arrays: dict[str, NDArray] = {
        key: np.concatenate([m.states[key] for m in motions.values()]).astype(np.float32)
        for key in STATE_KEYS
    }
    arrays["name"] = np.array(list(motions))
    arrays["period"] = np.array([motion.period for motion in motions.values()])
    arrays["count"] = np.array([len(m.states["joint_position"]) for m in motions.values()])
    np.savez_compressed(path, allow_pickle=False, **arrays)


def load_motions(robot: Robot) -> dict[str, Motion]:
    """The motions of a robot by name: those next to its MJCF, else they are made.

    Raises:
        ValueError: if the file is none.
    """
    path = motions_file(robot)
    if not path.is_file():
        return _made(robot)
    with arrays_of(path, "robot must have reference motions") as file:
        ends = np.cumsum(file["count"])[:-1]
        parts = {key: np.split(file[key], ends) for key in STATE_KEYS}
        return {
            str(name): Motion(float(period), {key: parts[key][i] for key in STATE_KEYS})
            for i, (name, period) in enumerate(zip(file["name"], file["period"], strict=True))
        }


@cache
def _made(robot: Robot) -> dict[str, Motion]:
    """The standing pose, and those of its gaits that the legs reach."""
    motions = make_motions(robot, {})
    for name, gait in gaits_of(robot).items():
        with suppress(ValueError):  # its legs are too short, or have other joints
            motions |= make_motions(robot, {name: gait})
    return {
        name: Motion(period, {key: each.astype(np.float32) for key, each in states.items()})
        for name, (period, states) in motions.items()
    }
