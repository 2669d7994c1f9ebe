"""Looks for poses in which the robot rests on its knees: ``python -m recipes.falling.kneel_pose``.

Draws poses of two kinds inside the joint ranges, half-kneels and kneels on both knees, puts each
on the floor, lets the servos hold it for three seconds, and keeps those that are at rest, upright
and off the hands. Each is held again 32 times with noise on its joints. Prints the best by the
share that still rests, torque and lean; the first is the keyframe ``kneel``, arms apart.
"""

from typing import TYPE_CHECKING

from ..shell import start

if TYPE_CHECKING:
    from zfall.falling.poses import Found
    from zfall.terminal import Sheet

DRAWS = 12  # batches of 512 poses
COLUMNS = ("robust", "torque rms [N m]", "lean [rad]", "CoM [m]")


def main() -> None:
    """Searches, and prints what was found."""
    import numpy as np
    from rich.console import Console

    from zfall.envs.humanoid import HumanoidEnv
    from zfall.falling.kneels import kneels_of
    from zfall.falling.poses import search_poses
    from zfall.terminal import print_sheet

    console, generator = Console(), np.random.default_rng(0)
    env = HumanoidEnv(num_envs=512, control_dt=0.04, physics_dt=0.004)
    copies = HumanoidEnv(num_envs=32, control_dt=0.04, physics_dt=0.004)
    for kind, search in kneels_of(env.robot).searches.items():
        found = search_poses(env, copies, kind, DRAWS, generator)
        tried = DRAWS * env.num_envs
        title = f"{kind}: {len(found)} of {tried} rest"
        print_sheet(shown(title, found[:5], env.robot.joints, search.shown), console)
        if found:
            console.print("qpos:", " ".join(f"{value:.6g}" for value in found[0].state))


def shown(
    title: str, poses: "list[Found]", joints: tuple[str, ...], legs: tuple[str, ...]
) -> "Sheet":
    """A row for each pose: its figures, and the angles of some joints of the legs [rad]."""
    import pandas as pd

    from zfall.terminal import Sheet

    rows = []
    for pose in poses:
        angles = [pose.angles[joints.index(joint)] for joint in legs]
        figures = (pose.robust, pose.torque, pose.leaning, pose.com_height, *angles)
        rows.append([f"{value:.3f}" for value in figures])
    return Sheet(pd.DataFrame(rows, columns=[*COLUMNS, *legs]), title)


if __name__ == "__main__":
    start(main)
