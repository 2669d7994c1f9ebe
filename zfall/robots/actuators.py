"""Actuators of any MJCF as servos: a target angle in, a limited torque out.

A position actuator stays what it is. A motor, or a DC motor that a voltage drives, gets our PD
controller in front of it. Others are refused: nothing would follow a target.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from zfall.robots.mjcf import follow

_FULL = 0.35  # error at which a motor with our controller gives all that it can [rad]
_ROUNDING = 1e-6  # share by which a largest torque may differ between both ways
Stiffness = float | Mapping[str, float] | None


def actuated_joints(model: mujoco.MjModel) -> list[str]:
    """Names of the joints that have an actuator, in the order of the actuators.

    Raises:
        ValueError: if an actuator acts on something else than a hinge with a name, or on one that
            has another.
    """
    joints: list[str] = []
    for number in range(model.nu):
        name = model.actuator(number).name or f"number {number}"
        on_joint = mujoco.mjtTrn(model.actuator_trntype[number]) == mujoco.mjtTrn.mjTRN_JOINT
        joint = int(model.actuator_trnid[number, 0])
        if not on_joint or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
            raise ValueError(f"actuator {name} must act on a hinge joint, it acts on another part")
        if not model.joint(joint).name:
            raise ValueError(f"the joint of actuator {name} must have a name")
        if model.joint(joint).name in joints:
            raise ValueError(f"joint {model.joint(joint).name} must have one actuator, has several")
        joints.append(model.joint(joint).name)
    return joints


def make_servos(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    joints: Sequence[str],
    *,
    stiffness: Stiffness,
    upright: Mapping[str, float],
) -> None:
    """Turns each actuator of a spec into a servo with the name of its joint; changes the spec.

    Args:
        spec: of the robot.
        model: compiled from its MJCF.
        joints: those that must have one.
        stiffness: [N m/rad], for all or by joint, with critical damping. ``None``: position
            actuators keep theirs; motors give their full torque at an error of 0.35 rad, and have
            at least ``upright`` in a leg.
        upright: least stiffness of joints that must hold the robot up [N m/rad].

    Raises:
        ValueError: on an actuator that cannot follow a target, has no largest torque, or another
            one each way.
    """
    renamed: dict[str, str] = {}
    for number, joint in enumerate(actuated_joints(model)):
        if joint not in joints:
            raise ValueError(f"joints must name all that have an actuator, {joint} is missing")
        actuator, hinge = spec.actuators[number], spec.joint(joint)
        known = stiffness.get(joint) if isinstance(stiffness, Mapping) else stiffness
        limit = _largest_torque(model, number, joint)
        match kind := _kind(model, number):
            case "position":
                gear, own = float(actuator.gear[0]), model.actuator_biasprm[number]
                if known:
                    actuator.set_to_position(kp=known, dampratio=1.0)
                elif gear != 1.0:  # the same servo, at the joint
                    actuator.set_to_position(kp=-own[1] * gear**2, kv=-own[2] * gear**2)
                if gear != 1.0:  # its targets are angles of the joint, too
                    actuator.inheritrange = 0.0
                    actuator.ctrlrange = np.sort(model.actuator_ctrlrange[number] / gear)
            case "motor" | "dcmotor":
                if kind == "dcmotor":
                    hinge.damping[0] += _back_emf(model, number)
                needed = max(limit / _FULL, upright.get(joint, 0.0))
                actuator.set_to_position(kp=known or needed, dampratio=1.0)
                actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
                actuator.ctrlrange = [0.0, 0.0]
        if not model.jnt_limited[model.joint(joint).id]:  # so far its targets may go
            free = [-np.pi, np.pi] if kind != "position" else list(actuator.ctrlrange)
            hinge.limited = mujoco.mjtLimited.mjLIMITED_FALSE
            hinge.range = free if free[0] < free[1] else [-np.pi, np.pi]
        actuator.gear = [1.0, 0, 0, 0, 0, 0]
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-limit, limit]
        hinge.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        if actuator.name:
            renamed[actuator.name] = joint
        actuator.name = f"zfall/{joint}"  # until no other has the name of the joint
    for number, joint in enumerate(actuated_joints(model)):
        spec.actuators[number].name = joint
    follow(spec, mujoco.mjtObj.mjOBJ_ACTUATOR, renamed)
    for joint in joints:
        if spec.actuator(joint) is None:
            raise ValueError(f"joints must have an actuator each, {joint} has none")


def _kind(model: mujoco.MjModel, number: int) -> str:
    """``position``, ``motor`` or ``dcmotor``; raises ``ValueError`` on any other."""
    gain = mujoco.mjtGain(model.actuator_gaintype[number])
    bias = mujoco.mjtBias(model.actuator_biastype[number])
    dynamics = mujoco.mjtDyn(model.actuator_dyntype[number])
    values, plain = model.actuator_biasprm[number], dynamics == mujoco.mjtDyn.mjDYN_NONE
    if gain == mujoco.mjtGain.mjGAIN_DCMOTOR and model.actuator_actnum[number] == 0:
        return "dcmotor"
    if plain and gain == mujoco.mjtGain.mjGAIN_FIXED:
        if bias == mujoco.mjtBias.mjBIAS_NONE:
            return "motor"
        same = abs(model.actuator_gainprm[number, 0] + values[1]) < 1e-9 and values[0] == 0.0
        if bias == mujoco.mjtBias.mjBIAS_AFFINE and values[1] < 0 and same:
            return "position"
    raise ValueError(
        f"actuator {model.actuator(number).name} must be a motor, a position actuator or a dcmotor "
        "without a state, to follow a target; it is another"
    )


def _largest_torque(model: mujoco.MjModel, number: int, joint: str) -> float:
    """At the joint [N m], both ways: the least of what limits it."""
    gear, on = float(model.actuator_gear[number, 0]), model.joint(joint).id
    limits = []
    if model.actuator_forcelimited[number]:
        limits.append(gear * model.actuator_forcerange[number])
    if model.jnt_actfrclimited[on]:
        limits.append(model.jnt_actfrcrange[on])
    kind = _kind(model, number)
    if kind != "position" and model.actuator_ctrllimited[number]:
        gain = model.actuator_gainprm[number]
        per_volt = gain[0] if kind == "motor" else gain[1] / gain[0]
        limits.append(gear * per_volt * model.actuator_ctrlrange[number])
    if not limits:
        raise ValueError(
            f"joint {joint} must have a largest torque: a forcerange of its actuator, or an "
            "actuatorfrcrange"
        )
    ranges = np.sort(limits, axis=-1)
    low, high = float(ranges[:, 0].max()), float(ranges[:, 1].min())
    if high <= 0.0 or abs(high + low) > _ROUNDING * high:
        raise ValueError(
            f"joint {joint} must have the same largest torque both ways, its actuator gives "
            f"{low:g} to {high:g} N m: give it a symmetric forcerange (of a motor, ctrlrange)"
        )
    return high


def _back_emf(model: mujoco.MjModel, number: int) -> float:
    """Of a DC motor at the joint, ``(gear K)^2 / R`` [N m s/rad]."""
    resistance, constant = model.actuator_gainprm[number, :2]
    return float((model.actuator_gear[number, 0] * constant) ** 2 / resistance)
