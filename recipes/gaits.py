"""Makes the reference motions that ship with the robot, and lets it walk them without feedback.

``python -m recipes.gaits`` writes the file beside the MJCF and prints the table of docs/reference/motions.md.
"""

from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms.falls import body_contact
from zfall.motions.gaits import Gait, Times
from zfall.motions.library import GAITS, make_motions, motions_file, save_motions, walk
from zfall.robots import ZEROTH01, Robot
from zfall.rotations import rotate_inverse

CONTROL_DT, PHYSICS_DT = 0.02, 0.005  # [s]; both divide a stride of 0.6 s
KINDS = ("position", "velocity", "torque")


class Walked(NamedTuple):
    """What became of worlds ``(W,)``.

    seconds: until a part other than the feet touched the floor [s].
    speed: forward, mean over the time on the feet [m/s].
    turn_rate: to the left, likewise [rad/s].
    """

    seconds: Tensor
    speed: Tensor
    turn_rate: Tensor


def follow(gait: Gait, kind: str, *, seconds: float, starts: int = 15) -> Walked:
    """Lets the servos follow a gait by the clock, with nothing that would keep the balance.

    Each world starts in the gait's own state, at another phase. The servos are commanded the
    gait's angles q alone (``position``), or also what their damping takes away,
    ``q + (damping / stiffness) dq/dt`` (``velocity``), or also what all forces take away,
    ``q + torque / stiffness`` (``torque``).
    """
    begin, end = gait.stride
    ticks = round((end - begin) / PHYSICS_DT)
    time = begin + PHYSICS_DT * np.arange(ticks)
    table = _tensors(walk(ZEROTH01, gait, time))
    env = HumanoidEnv(num_envs=starts, control_dt=CONTROL_DT, physics_dt=PHYSICS_DT)
    command = table["joint_position"].clone()
    if kind == "velocity":
        command += env.servo_time_constant * table["joint_velocity"]
    elif kind == "torque":
        model = env.simulation.model
        stiffness = [-model.actuator(name).biasprm[1] for name in env.robot.joints]
        command += torch.from_numpy(servo_torque(ZEROTH01, gait, time) / stiffness).float()
    phase = torch.arange(starts) * ticks // starts
    tick = phase[:, None] + torch.arange(env.substeps)
    steps = range(round(seconds / CONTROL_DT))
    controls = (command[(tick + step * env.substeps) % ticks] for step in steps)
    return _play(env, {key: value[phase] for key, value in table.items()}, controls)


def pose_hold(gait: Gait, *, seconds: float, starts: int = 15) -> Walked:
    """Lets the servos pull the robot from the midst of a gait into the standing pose."""
    begin, end = gait.stride
    time = begin + (end - begin) / starts * np.arange(starts)
    env = HumanoidEnv(num_envs=starts, control_dt=CONTROL_DT, physics_dt=PHYSICS_DT)
    stand = env.stand_position.expand(starts, env.substeps, -1)
    controls = (stand for _ in range(round(seconds / CONTROL_DT)))
    return _play(env, _tensors(walk(ZEROTH01, gait, time)), controls)


def servo_torque(robot: Robot, gait: Gait, time: Times) -> NDArray[np.float64]:
    """Torques ``(T, J)`` [N m] that the gait asks of the servos, by inverse dynamics.

    The six equations of the base give the floor's force and torque on the standing sole; in
    double support both soles share them in the proportion in which the zero-moment point lies
    between them.
    """
    model = mujoco.MjModel.from_xml_path(robot.mjcf)
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


def _tensors(states: dict[str, NDArray[np.floating]]) -> dict[str, Tensor]:
    return {key: torch.from_numpy(value).float() for key, value in states.items()}


def _play(env: HumanoidEnv, start: dict[str, Tensor], controls: Iterable[Tensor]) -> Walked:
    td: TensorDictBase = env.reset(TensorDict({"start": start}, batch_size=[env.num_envs]))
    up = torch.ones(env.num_envs, dtype=torch.bool)
    steps, forward, turn = (torch.zeros(env.num_envs) for _ in range(3))
    for control in controls:
        td["control"] = control
        td = env.step(td)["next"]
        up &= ~body_contact(td, td)[:, 0]
        steps += up
        velocity = rotate_inverse(td["base_orientation"], td["base_linear_velocity"])
        forward += up * velocity[:, 0]
        turn += up * td["base_angular_velocity"][:, 2]
    return Walked(steps * env.control_dt, forward / steps, turn / steps)


def main(seconds: float = 10.0) -> None:
    """Writes the motions and prints what becomes of a robot that starts in them."""
    motions = make_motions(ZEROTH01, GAITS)
    path = motions_file(ZEROTH01)
    save_motions(motions, path)
    table = Table(title=f"{path.name}: shortest time on the feet, and mean speed, by command")
    for column in ("motion", "step, mm", "joints, rad/s", *KINDS, "standing pose"):
        table.add_column(column, justify="right")
    for name, gait in GAITS.items():
        fastest = np.abs(motions[name].states["joint_velocity"]).max()
        followed = [_cell(gait, follow(gait, kind, seconds=seconds)) for kind in KINDS]
        hold = pose_hold(gait, seconds=seconds)
        row = (f"{1e3 * gait.step_length:.0f}", f"{fastest:.1f}", *followed)
        table.add_row(name, *row, f"{hold.seconds.min():.1f} s")
    Console(width=140).print(table)


def _cell(gait: Gait, walked: Walked) -> str:
    turn = f"{walked.turn_rate.mean():.2f} rad/s"
    speed = f"{walked.speed.mean():.3f} m/s"
    return f"{walked.seconds.min():.1f} s  {turn if gait.turn_rate else speed}"


if __name__ == "__main__":
    main()
