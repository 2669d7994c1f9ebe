"""Looks for poses in which the robot rests on its knees: ``python -m recipes.falling.kneel_pose``.

Draws poses of two kinds inside the joint ranges, half-kneels and kneels on both knees, puts each
on the floor, lets the servos hold it for three seconds, and keeps those that are at rest, upright
and off the hands. Each is held again 32 times with noise on its joints. Prints the best by the
share that still rests, torque and lean; the first is the keyframe ``kneel``, arms apart.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from tensordict import TensorDict

from zfall.envs.humanoid import HumanoidEnv
from zfall.falling.terms import resting_kneel, touching
from zfall.robots import ZEROTH01
from zfall.rotations import tilt

Array = NDArray[np.float64]

# Uniform ranges of the leg joints and the trunk's lean [rad]: front and rear leg, or both the same.
HALF = {
    "front": {"hip_pitch": (-1.57, -0.8), "knee_pitch": (-1.2, -0.2), "ankle_pitch": (-0.5, 0.3)},
    "rear": {"hip_pitch": (0.2, 0.87), "knee_pitch": (-1.39, -0.6), "ankle_pitch": (-0.6, 0.6)},
}
BOTH = {"hip_pitch": (0.2, 0.87), "knee_pitch": (-1.39, -0.9), "ankle_pitch": (-0.6, 0.69)}
KINDS = {"half-kneel": HALF, "both knees": {"front": BOTH, "rear": BOTH}}
LEAN, SPREAD = (-0.4, 0.5), (0.0, 0.4)
DRAWS = 12  # batches of 512 poses
NOISE = 0.035  # of the copies that a pose must rest with [rad]
LEGS = (
    [f"right_{joint}" for joint in BOTH] + [f"left_{joint}" for joint in BOTH] + ["left_hip_roll"]
)


@dataclass
class Found:
    """A pose at rest: angles ``(J,)`` and lean it began with, and what it came to [rad, N m, m]."""

    angles: Array
    lean: float
    torque: float
    leaning: float
    com_height: float
    state: Array
    robust: float = 0.0


def draw(kind: str, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """Joint angles ``(count, J)`` and leans ``(count,)`` of poses of a kind."""
    joints = ZEROTH01.joints
    angles = np.tile(np.array(ZEROTH01.stand_position), (count, 1))
    for side, leg in (("left", "front"), ("right", "rear")):
        for joint, (low, high) in KINDS[kind][leg].items():
            angles[:, joints.index(f"{side}_{joint}")] = generator.uniform(low, high, count)
        angles[:, joints.index(f"{side}_ankle_roll")] = 0.0
    if kind == "both knees":
        for joint in BOTH:
            angles[:, joints.index(f"right_{joint}")] = angles[:, joints.index(f"left_{joint}")]
    spread = generator.uniform(*SPREAD, count)
    angles[:, joints.index("left_hip_roll")] = spread
    angles[:, joints.index("right_hip_roll")] = -spread
    return angles, generator.uniform(*LEAN, count)


def lowest(model: mujoco.MjModel, data: mujoco.MjData) -> float:
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


def hold(env: HumanoidEnv, angles: Array, lean: Array, seconds: float) -> TensorDict:
    """What the worlds are in after the servos held these poses for some time."""
    model, count = env.simulation.model, len(angles)
    data = mujoco.MjData(model)
    places = [int(model.joint(joint).qposadr[0]) for joint in env.robot.joints]
    turn = np.stack([np.cos(lean / 2), 0 * lean, np.sin(lean / 2), 0 * lean], 1)
    position = np.zeros((count, 3))
    for world in range(count):
        data.qpos[:7] = [0, 0, 0, *turn[world]]
        data.qpos[places] = angles[world]
        mujoco.mj_kinematics(model, data)
        position[world, 2] = 0.001 - lowest(model, data)
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


def search(
    env: HumanoidEnv, copies: HumanoidEnv, kind: str, generator: np.random.Generator
) -> list[Found]:
    """Poses of a kind at rest, most robust and least leaning first."""
    robot, found = env.robot, []
    for _ in range(DRAWS):
        angles, lean = draw(kind, env.num_envs, generator)
        td = hold(env, angles, lean, 3.0)
        good = resting_kneel(td, td, robot=robot) & ~touching(td, robot, "hand", "arm")
        torque = td["joint_torque"].square().mean(-1).sqrt()
        leaning = tilt(td["base_orientation"])
        for world in good[:, 0].nonzero()[:, 0].tolist():
            figures = (float(torque[world]), float(leaning[world]))
            height, state = float(td["com_position"][world, 2]), env.simulation.qpos[world].numpy()
            found.append(Found(angles[world], lean[world], *figures, height, state.copy()))
    low, high = env.joint_range.numpy().T
    for pose in found:  # again, a world for each noise
        noise = generator.normal(0.0, NOISE, (copies.num_envs, len(robot.joints)))
        angles = np.clip(pose.angles + noise, low, high)
        td = hold(copies, angles, np.full(copies.num_envs, pose.lean), 3.0)
        good = resting_kneel(td, td, robot=robot) & ~touching(td, robot, "hand", "arm")
        pose.robust = float(good.float().mean())
    return sorted(found, key=lambda pose: -pose.robust + pose.torque + pose.leaning)


def main() -> None:
    """Searches, and prints what was found."""
    console, generator = Console(), np.random.default_rng(0)
    env = HumanoidEnv(num_envs=512, control_dt=0.04, physics_dt=0.004)
    copies = HumanoidEnv(num_envs=32, control_dt=0.04, physics_dt=0.004)
    for kind in KINDS:
        found = search(env, copies, kind, generator)
        table = Table(title=f"{kind}: {len(found)} of {DRAWS * env.num_envs} rest")
        columns = ("robust", "torque rms [N m]", "lean [rad]", "CoM [m]")
        for name in (*columns, *LEGS):
            table.add_column(name)
        for pose in found[:5]:
            legs = [pose.angles[env.robot.joints.index(joint)] for joint in LEGS]
            figures = (pose.robust, pose.torque, pose.leaning, pose.com_height, *legs)
            table.add_row(*(f"{value:.3f}" for value in figures))
        console.print(table)
        if found:
            console.print("qpos:", " ".join(f"{value:.6g}" for value in found[0].state))


if __name__ == "__main__":
    main()
