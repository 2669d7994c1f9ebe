"""The files of falling that ship: banks of falls, movements, networks."""

from importlib.resources import files
from pathlib import Path

from zfall.robots import ZEROTH01, Robot

ASSETS = Path(str(files("zfall.falling"))) / "assets"
MOVEMENTS = ASSETS / "zeroth01_catches.npz"


def own_file(robot: Robot, ending: str) -> Path:
    """The file of a robot, ``own_file(ZEROTH01, "falls.npz")``: next to its MJCF, else ours.

    What ships is of the robot that ships: another MJCF of the same name does not get it.
    """
    name = f"{robot.name}_{ending}"
    beside = Path(robot.mjcf).with_name(name)
    return beside if beside.is_file() or robot.mjcf != ZEROTH01.mjcf else ASSETS / name
