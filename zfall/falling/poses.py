"""Searches poses in which the robot rests on its knees."""

from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.falling.kneels import kneels_of
from zfall.falling.terms import resting_kneel, touching
from zfall.robots import Robot
from zfall.rotations import tilt

Array = NDArray[np.float64]

# Uniform ranges of the trunk's lean, and of how far the legs part [rad].
_LEAN, _SPREAD = (-0.4, 0.5), (0.0, 0.4)
SECONDS = 3.0  # for which the servos hold a pose
NOISE = 0.035  # of the copies that a pose must rest with [rad]


@dataclass
class Found:
    """A pose at rest.

    Attributes:
        angles, lean: of the joints ``(J,)`` and the trunk at the begin [rad].
        torque: root of the mean square over joints at the end [N m].
        leaning: tilt at the end [rad].
        com_height: height of the center of mass at the end [m].
        state: positions of the model at the end ``(nq,)``.
        robust: share of copies with noise on their joints that rest, too.
    """

    angles: Array
    lean: float
    torque: float
    leaning: float
    com_height: float
    state: Array
    robust: float = 0.0


def search_poses(
    env: HumanoidEnv, copies: HumanoidEnv, kind: str, draws: int, generator: np.random.Generator
) -> list[Found]:
    """Poses of a kind at rest, upright and off the hands; robust ones that lean little come first.

    Args:
        env: in whose worlds the poses are tried.
        copies: in whose worlds each is tried again, with noise.
        kind: one of the robot's ``searches``, see ``zfall.falling.kneels``.
        draws: batches of poses, each of as many as ``env`` has worlds.
        generator: of poses and noise.
    """
    robot, found = env.robot, []
    for _ in range(draws):
        angles, lean = draw(robot, kind, env.num_envs, generator)
        td = settle(env, angles, lean, SECONDS)
        torque = td["joint_torque"].square().mean(-1).sqrt()
        leaning = tilt(td["base_orientation"])
        for world in _rest(td, robot).nonzero()[:, 0].tolist():
            figures = (float(torque[world]), float(leaning[world]))
            height, state = float(td["com_position"][world, 2]), env.simulation.qpos[world].numpy()
            found.append(Found(angles[world], lean[world], *figures, height, state.copy()))
    low, high = env.joint_range.numpy().T
    for pose in found:  # again, a world for each noise
        noise = generator.normal(0.0, NOISE, (copies.num_envs, len(robot.joints)))
        angles = np.clip(pose.angles + noise, low, high)
        td = settle(copies, angles, np.full(copies.num_envs, pose.lean), SECONDS)
        pose.robust = float(_rest(td, robot).float().mean())
    return sorted(found, key=lambda pose: -pose.robust + pose.torque + pose.leaning)


def draw(
    robot: Robot, kind: str, count: int, generator: np.random.Generator
) -> tuple[Array, Array]:
    """Joint angles ``(count, J)`` and leans ``(count,)`` of poses of a kind [rad]."""
    joints, search = robot.joints, kneels_of(robot).searches[kind]
    angles = np.tile(np.array(robot.stand_position), (count, 1))
    for joint, (low, high) in search.ranges.items():
        angles[:, joints.index(joint)] = generator.uniform(low, high, count)
    for joint in search.zero:
        angles[:, joints.index(joint)] = 0.0
    for joint, other in search.same.items():
        angles[:, joints.index(joint)] = angles[:, joints.index(other)]
    spread = generator.uniform(*_SPREAD, count)
    for joint, sign in zip(search.spread, (1.0, -1.0), strict=True):
        angles[:, joints.index(joint)] = sign * spread
    return angles, generator.uniform(*_LEAN, count)


def settle(env: HumanoidEnv, angles: Array, lean: Array, seconds: float) -> TensorDict:
    """What follows when servos hold poses ``(N, J)`` with leans ``(N,)`` [rad] for a time [s]."""
    model, count = env.simulation.model, len(angles)
    data = mujoco.MjData(model)
    places = [int(model.joint(joint).qposadr[0]) for joint in env.robot.joints]
    turn = np.stack([np.cos(lean / 2), 0 * lean, np.sin(lean / 2), 0 * lean], 1)
    position = np.zeros((count, 3))
    for world in range(count):
        data.qpos[:7] = [0, 0, 0, *turn[world]]
        data.qpos[places] = angles[world]
        mujoco.mj_kinematics(model, data)
        position[world, 2] = 0.001 - _lowest(model, data)
    start = {"joint_position": angles, "base_orientation": turn, "base_position": position}
    td = TensorDict(
        {("start", key): torch.tensor(value).float() for key, value in start.items()},
        batch_size=[count],
    )
    env.reset(td)
    target = torch.tensor(angles).float()
    for _ in range(round(seconds / env.control_dt)):
        td = env.step(TensorDict({"target": target}, batch_size=[count]))["next"]
    return td


def _rest(td: TensorDict, robot: Robot) -> Tensor:
    """Whether worlds rest on a knee, off the hands ``(N,)`` bool."""
    return (resting_kneel(td, td, robot=robot) & ~touching(td, robot, "hand", "arm"))[:, 0]


def _lowest(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Height of the lowest point of the robot [m]."""
    heights = []
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] == 0 or model.geom_contype[geom] == 0:
            continue
        size, up = model.geom_size[geom], data.geom_xmat[geom].reshape(3, 3)[2]
        drop = {
            mujoco.mjtGeom.mjGEOM_BOX: np.abs(up) @ size,
            mujoco.mjtGeom.mjGEOM_CAPSULE: size[0] + abs(up[2]) * size[1],
        }.get(mujoco.mjtGeom(model.geom_type[geom]), size[0])
        heights.append(data.geom_xpos[geom][2] - drop)
    return float(min(heights))
