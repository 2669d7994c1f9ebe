"""Makes the reference motions that ship with the robot, and lets it walk them without feedback.

``python -m recipes.gaits`` writes the file next to the MJCF and prints the table of
``docs/reference/motions.md``.
"""

from typing import TYPE_CHECKING

from .shell import start

if TYPE_CHECKING:
    from zfall.envs.open_loop import Walked
    from zfall.motions.gaits import Gait


def main(seconds: float = 10.0) -> None:
    """Writes the motions and prints what becomes of a robot that starts in them."""
    import numpy as np
    import pandas as pd
    from rich.console import Console

    from zfall.envs.open_loop import KINDS, follow, pose_hold
    from zfall.motions import library
    from zfall.robots import DEFAULT
    from zfall.terminal import Sheet, print_sheet

    walks = library.gaits_of(DEFAULT)
    motions = library.make_motions(DEFAULT, walks)
    path = library.motions_file(DEFAULT)
    library.save_motions(motions, path)
    title = f"{path.name}: shortest time on the feet, and mean speed, by command"
    columns, rows = ["motion", "step, mm", "joints, rad/s", *KINDS, "standing pose"], []
    for name, gait in walks.items():
        fastest = np.abs(motions[name].states["joint_velocity"]).max()
        followed = [_cell(gait, follow(gait, kind, seconds=seconds)) for kind in KINDS]
        hold = pose_hold(gait, seconds=seconds)
        row = (f"{1e3 * gait.step_length:.0f}", f"{fastest:.1f}", *followed)
        rows.append([name, *row, f"{hold.seconds.min():.1f} s"])
    print_sheet(Sheet(pd.DataFrame(rows, columns=columns), title), Console())


def _cell(gait: "Gait", walked: "Walked") -> str:
    turn = f"{walked.turn_rate.mean():.2f} rad/s"
    speed = f"{walked.speed.mean():.3f} m/s"
    return f"{walked.seconds.min():.1f} s  {turn if gait.turn_rate else speed}"


if __name__ == "__main__":
    start(main)
