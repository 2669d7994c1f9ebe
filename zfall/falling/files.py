"""The files of falling that ship: banks of falls, movements, networks."""

from importlib.resources import files
from pathlib import Path

from zfall.robots import Robot

ASSETS = Path(str(files("zfall.falling"))) / "assets"
MOVEMENTS = ASSETS / "zeroth01_catches.npz"


def own_file(robot: Robot, ending: str) -> Path:
    """The file of a robot that ships: ``own_file(ZEROTH01, "falls.npz")``."""
    return ASSETS / f"{robot.name}_{ending}"
