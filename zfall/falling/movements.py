"""Movements that catch a fall, and where they are stored."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from zfall.arrays import arrays_of
from zfall.falling.files import own_file
from zfall.robots import Robot

HEADINGS = tuple(range(0, 360, 30))  # [degrees], first straight ahead, then by the left


class Catches(NamedTuple):
    """Targets to go through, by the heading and the speed of the fall.

    Attributes:
        postures: ``(H, B, K, J)`` [rad]: for each of ``HEADINGS`` and B bins of speed, K postures
            one after the other. No robot is quite symmetric: left and right have different ones.
        until: when each posture ends, from the begin of the movement ``(K,)`` [s]; the last never.
        speeds: of the center of mass along the ground, between the bins ``(B - 1,)`` [m/s].
    """

    postures: Tensor
    until: Tensor
    speeds: Tensor

    def nearest(self, x: Tensor, y: Tensor) -> Tensor:
        """Number of the movement, of ``H x B``, for a velocity in the robot's heading [m/s]."""
        sectors = len(self.postures)
        sector = (torch.atan2(y, x) * (sectors / (2.0 * torch.pi))).round().long() % sectors
        speed = torch.bucketize(torch.hypot(x, y), self.speeds, right=True)
        return sector * self.postures.shape[1] + speed


def catches_path(robot: Robot) -> Path:
    """The file of a robot's catches that ships."""
    return own_file(robot, "catches.npz")


def load_catches(robot: Robot, path: Path | None = None) -> Catches:
    """The movements of a file; without a path, those of the robot that ship.

    Raises:
        ValueError: if there is no such file, or it is of another robot.
    """
    path = path or catches_path(robot)
    with arrays_of(path, "catches must be a file that recipes.falling.catches wrote") as file:
        postures, until, speeds = (
            torch.from_numpy(file[k]).float() for k in ("postures", "until", "speeds")
        )
    if (postures.shape[0], postures.shape[-1]) != (len(HEADINGS), len(robot.joints)):
        raise ValueError(f"catches must be of {robot.name}, {path} has other joints or headings.")
    if postures.shape[1:3] != (len(speeds) + 1, len(until)) or not until[-1].isinf():
        raise ValueError(f"catches must have a bin for all speeds and times, {path} lacks some.")
    return Catches(postures, until, speeds)


def save_catches(path: Path, postures: Tensor, until: Tensor, speeds: Tensor) -> None:
    """Writes a file that ``load_catches`` reads; arguments as in ``Catches``."""
    np.savez_compressed(
        path,
        postures=postures.float().numpy(),
        until=until.float().numpy(),
        speeds=speeds.float().numpy(),
    )
