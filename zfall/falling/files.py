"""The files of falling that ship: banks of falls, movements, networks."""

from importlib.resources import files
from pathlib import Path

from zfall.robots import DEFAULT, Robot

ASSETS = Path(str(files("zfall.falling"))) / "assets"
MOVEMENTS = ASSETS / f"{DEFAULT.name}_catches.npz"


def own_file(robot: Robot, ending: str) -> Path:
    """The file of a robot, ``own_file(robot, "falls.npz")``: next to its MJCF, else ours.

    What ships is of the robot that ships: another MJCF of the same name does not get it.
    """
    name = f"{robot.name}_{ending}"
    beside = Path(robot.mjcf).with_name(name)
    return beside if beside.is_file() or robot.mjcf != DEFAULT.mjcf else ASSETS / name
