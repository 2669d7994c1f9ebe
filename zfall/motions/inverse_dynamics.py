"""Torques that a walk needs, by inverse dynamics."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from zfall.motions.gaits import Gait, Times
from zfall.motions.library import walk
from zfall.robots import Robot, bare_model


def servo_torque(robot: Robot, gait: Gait, time: Times) -> NDArray[np.float64]:
    """Torques ``(T, J)`` [N m] that the gait asks of the servos, by inverse dynamics.

    The six equations of the base give the floor's force and torque on the standing sole; in
    double support both soles share them in the proportion in which the zero-moment point lies
    between them.
    """
    model = bare_model(robot)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    states = walk(robot, gait, time)
    joints = [model.joint(name) for name in robot.joints]
    dofs = np.array([int(joint.dofadr[0]) for joint in joints])
    velocity = np.zeros((len(time), model.nv))
    velocity[:, :3], velocity[:, 3:6] = (
        states["base_linear_velocity"],
        states["base_angular_velocity"],
    )
    velocity[:, dofs] = states["joint_velocity"]
    acceleration = np.gradient(velocity, time, axis=0)
    shares = weight_shares(gait, time)
    soles = [model.sensor_objid[model.sensor(f"feet_position/{foot}").id] for foot in robot.feet]
    torque = np.empty((len(time), len(joints)))
    for k in range(len(time)):
        data.qpos[:3], data.qpos[3:7] = states["base_position"][k], states["base_orientation"][k]
        data.qpos[[int(joint.qposadr[0]) for joint in joints]] = states["joint_position"][k]
        data.qvel[:], data.qacc[:] = velocity[k], acceleration[k]
        mujoco.mj_inverse(model, data)
        jacobian = np.zeros((2, 6, model.nv))
        for sole, share, part in zip(soles, shares[k], jacobian, strict=True):
            mujoco.mj_jacSite(model, data, part[:3], part[3:], sole)
            part *= share
        # Least squares, so that soles side by side share the weight and do not pull at each other.
        reach = jacobian.reshape(12, -1)
        wrench = np.linalg.lstsq(reach[:, :6].T, data.qfrc_inverse[:6], rcond=None)[0]
        torque[k] = (data.qfrc_inverse - reach.T @ wrench)[dofs]
    return torque


def weight_shares(gait: Gait, time: Times) -> NDArray[np.float64]:
    """Share of the weight that the left and the right sole carry ``(T, 2)``."""
    n = np.floor(time / gait.step_time)
    since = time - n * gait.step_time
    edge = np.minimum(since, gait.step_time - since)  # from the nearer change of feet
    standing = np.minimum(0.5 + edge / gait.double_support, 1.0)
    left = np.where(n % 2 == 0, standing, 1 - standing)
    return np.stack([left, 1 - left], -1)
