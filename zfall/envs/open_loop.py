"""What becomes of the robot when its servos follow a walk by the clock, without feedback."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms.falls import body_contact
from zfall.motions.gaits import Gait
from zfall.motions.inverse_dynamics import servo_torque
from zfall.motions.library import walk
from zfall.robots import DEFAULT, Robot
from zfall.rotations import rotate_inverse

CONTROL_DT, PHYSICS_DT = 0.02, 0.005  # [s]; both divide a stride of 0.6 s
KINDS = ("position", "velocity", "torque")  # of commands, see ``follow``


class Walked(NamedTuple):
    """What became of worlds ``(W,)``.

    seconds: until a part other than the feet touched the floor [s].
    speed: forward, mean over the time on the feet [m/s].
    turn_rate: to the left, likewise [rad/s].
    """

    seconds: Tensor
    speed: Tensor
    turn_rate: Tensor


def follow(
    gait: Gait, kind: str, *, seconds: float, starts: int = 15, robot: Robot = DEFAULT
) -> Walked:
    """Lets the servos follow a gait by the clock, with nothing that would keep the balance.

    Each world starts in the gait's own state, at another phase. The servos are commanded the
    gait's angles q alone (``position``), or also what their damping takes away,
    ``q + (damping / stiffness) dq/dt`` (``velocity``), or also what all forces take away,
    ``q + torque / stiffness`` (``torque``).
    """
    begin, end = gait.stride
    ticks = round((end - begin) / PHYSICS_DT)
    time = begin + PHYSICS_DT * np.arange(ticks)
    table, env = _tensors(walk(robot, gait, time)), _env(robot, starts)
    command = table["joint_position"].clone()
    if kind == "velocity":
        command += env.servo_time_constant * table["joint_velocity"]
    elif kind == "torque":
        model = env.simulation.model
        stiffness = [-model.actuator(name).biasprm[1] for name in env.robot.joints]
        command += torch.from_numpy(servo_torque(robot, gait, time) / stiffness).float()
    phase = torch.arange(starts) * ticks // starts
    tick = phase[:, None] + torch.arange(env.substeps)
    steps = range(round(seconds / CONTROL_DT))
    controls = (command[(tick + step * env.substeps) % ticks] for step in steps)
    return _play(env, {key: value[phase] for key, value in table.items()}, controls)


def pose_hold(gait: Gait, *, seconds: float, starts: int = 15, robot: Robot = DEFAULT) -> Walked:
    """Lets the servos pull the robot from the midst of a gait into the standing pose."""
    begin, end = gait.stride
    time = begin + (end - begin) / starts * np.arange(starts)
    env = _env(robot, starts)
    stand = env.stand_position.expand(starts, env.substeps, -1)
    controls = (stand for _ in range(round(seconds / CONTROL_DT)))
    return _play(env, _tensors(walk(robot, gait, time)), controls)


def _env(robot: Robot, starts: int) -> HumanoidEnv:
    return HumanoidEnv(num_envs=starts, control_dt=CONTROL_DT, physics_dt=PHYSICS_DT, robot=robot)


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
