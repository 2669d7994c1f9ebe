"""A servo alone on a bench: its shaft, what hangs on it, and the commands of a log."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from zfall.robots import GRAVITY
from zfall.robots.servos import Servo
from zfall.robots.servos.logs import Load, ServoLog
from zfall.simulation.servos import put_servo

Array = NDArray[np.float64]

_OF_SERVO = ("dof_damping", "dof_frictionloss", "dof_armature")
_OF_VOLTAGE = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
_LEAST = 1e-9  # mass [kg] and inertia [kg m2] of an empty shaft: MuJoCo wants some


@dataclass(frozen=True, kw_only=True)
class LateServo:
    """A servo whose commands arrive late.

    Args:
        servo: its ``backlash`` is play of the command, as in the transform ``Backlash``.
        latency: from a row's time to the torque of its command [s].
    """

    servo: Servo
    latency: float


def run_bench(units: Sequence[LateServo], log: ServoLog, *, physics_dt: float) -> Array:
    """Positions of servos at the times of a log's rows ``(N, T)`` [rad], under its commands.

    The actuators are those of ``put_servo``, as in the robot; they begin at rest where the log
    does. Each row's time to the next is divided into equal physics steps, so that a command acts
    at its time, to the end of no step. A latency moves all positions in time, the voltage with
    them, and is as continuous as they are.

    MuJoCo's step takes the torque of its beginning, half a step early, and the damping of its end,
    as if the inertia were ``damping dt / 2`` more. Both are taken back here: the error falls with
    the square of the step, 0.06 mrad at 2 ms where an STS3250 steps by 1 rad.

    Args:
        units: N of them.
        log: its positions but those at rest are not read.
        physics_dt: longest physics step [s].

    Raises:
        ValueError: if a servo lacks friction, armature or backlash.
    """
    time = np.append(log.time, 2 * log.time[-1] - log.time[-2])
    counts = np.ceil(np.diff(time) / physics_dt - 1e-6).astype(int)
    models = [_model(unit.servo, log.load, time[-1] / counts.sum()) for unit in units]
    batch = mujoco.batch.Batch(models[0], nsim=len(units), nthread=1)
    for name in _OF_SERVO:
        batch.expand(name)[:] = np.stack([getattr(model, name) for model in models])
    batch.set_const()
    fields = [batch.expand(name) for name in _OF_VOLTAGE]
    of_sheet = [np.stack([getattr(model, name) for model in models]) for name in _OF_VOLTAGE]
    sheet_voltage = np.array([unit.servo.voltage for unit in units])
    timestep = batch.expand("opt.timestep")
    batch.bind("qpos")[:] = log.start
    half = np.array([unit.servo.need("backlash") / 2 for unit in units])
    stiffness = (
        np.array([unit.servo.stiffness() for unit in units]) * log.voltage[0] / sheet_voltage
    )
    level = log.start - _gravity(log.load, log.start) / stiffness  # at which it rests there
    positions, times, voltage = [], [], 0.0
    for row, count in enumerate(counts.tolist()):
        if log.voltage[row] != voltage:
            voltage = log.voltage[row]
            for field, value in zip(fields, of_sheet, strict=True):
                share = voltage / sheet_voltage
                field[:] = share.reshape(-1, *[1] * (value.ndim - 1)) * value
        level = np.clip(level, log.target[row] - half, log.target[row] + half)
        dt = timestep[:] = (time[row + 1] - time[row]) / count
        control = np.repeat(level, count).reshape(-1, count, 1)
        positions.append(batch.rollout(count, control, record=("qpos",))["qpos"][..., 0])
        times.append(time[row] + dt * (1.5 + np.arange(count)))
    at, rolled = np.concatenate(times), np.concatenate(positions, axis=1)
    arrived = [log.time - unit.latency for unit in units]
    each = zip(arrived, rolled, strict=True)
    return np.stack([np.interp(late, at, line, left=log.start) for late, line in each])


def _gravity(load: Load, position: float) -> float:
    """Torque of gravity at the shaft [N m]."""
    return -GRAVITY * load.mass * load.arm * math.sin(position - load.down)


def _model(servo: Servo, load: Load, dt: float) -> mujoco.MjModel:
    """A shaft with a servo and its load, compiled."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # as the robot's
    hub = spec.worldbody.add_body(name="hub")
    hinge = hub.add_joint(name="shaft", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 1.0, 0.0])
    hub.explicitinertial, hub.mass = True, max(load.mass, _LEAST)
    hub.inertia = [max(load.inertia, _LEAST)] * 3
    hub.ipos = [load.arm * math.sin(load.down), 0.0, -load.arm * math.cos(load.down)]
    actuator = spec.add_actuator(name="shaft", trntype=mujoco.mjtTrn.mjTRN_JOINT, target="shaft")
    actuator.set_to_motor()
    put_servo(spec, "shaft", servo)
    hinge.armature = max(hinge.armature - servo.damping * dt / 2, _LEAST)
    return spec.compile()
