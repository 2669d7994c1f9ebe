"""Movements that get up, and where they are stored."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from zfall.arrays import arrays_of
from zfall.falling.files import own_file
from zfall.falling.lying import POSTURES
from zfall.robots import Robot


class Rises(NamedTuple):
    """Keyframes to go through, by the posture in which the robot lies or kneels.

    A movement begins where the target is and goes from keyframe to keyframe in straight lines.

    Attributes:
        keyframes: ``(P, K, J)`` [rad], for each of ``POSTURES``; shorter movements repeat the last.
        ends: when each keyframe is reached, from the begin of the movement ``(P, K)`` [s].
    """

    keyframes: Tensor
    ends: Tensor

    def target(self, posture: Tensor, begin: Tensor, time: Tensor) -> Tensor:
        """The targets ``(N, J)`` [rad] at a time of the movement.

        Args:
            posture: movement of each world ``(N,)``.
            begin: target where the movement began ``(N, J)`` [rad].
            time: since then ``(N,)`` [s].
        """
        ends, keyframes = self.ends[posture], self.keyframes[posture]
        rows, last = torch.arange(len(time)), ends.shape[1] - 1
        phase = (ends <= time[:, None] + 1e-6).sum(1).clamp(max=last)
        first = phase == 0
        start = torch.where(first, 0.0, ends[rows, phase - 1])
        before = torch.where(first[:, None], begin, keyframes[rows, phase - 1])
        took = (ends[rows, phase] - start).clamp_min(1e-6)
        share = ((time - start) / took).clamp(0.0, 1.0)
        return before + share[:, None] * (keyframes[rows, phase] - before)

    def over(self, posture: Tensor, time: Tensor) -> Tensor:
        """Whether the movements have reached their last keyframe ``(N,)`` bool."""
        return time > self.ends[posture, -1] - 1e-6


def rises_path(robot: Robot) -> Path:
    """The file of a robot's rises that ships."""
    return own_file(robot, "rises.npz")


def load_rises(robot: Robot, path: Path | None = None) -> Rises:
    """The movements of a file; without a path, those of the robot that ship.

    Raises:
        ValueError: if there is no such file, or it is of another robot.
    """
    path = path or rises_path(robot)
    rule = "rises must be a file that recipes.falling.rises wrote"
    with arrays_of(path, rule) as file:
        keyframes, ends = (torch.from_numpy(file[key]).float() for key in ("keyframes", "ends"))
    if keyframes.shape != (*ends.shape, len(robot.joints)) or len(ends) != len(POSTURES):
        raise ValueError(f"rises must be of {robot.name}, {path} has other joints or postures.")
    if not (keyframes.isfinite().all() and (ends > 0).all() and (ends.diff(dim=1) >= 0).all()):
        raise ValueError(f"rises must have finite angles at rising times, {path} has others.")
    return Rises(keyframes, ends)


def save_rises(path: Path, rises: Rises) -> None:
    """Writes a file that ``load_rises`` reads."""
    arrays: dict[str, Any] = {key: value.float().numpy() for key, value in rises._asdict().items()}
    np.savez_compressed(path, **arrays)


def written_rises(robot: Robot, table: Mapping[str, Sequence[Mapping[str, float]]]) -> Rises:
    """Movements that are written as a table.

    Args:
        robot: whose joints they are.
        table: for each of ``POSTURES`` its keyframes. Each has ``seconds``, how long the way to
            it takes, and angles by joint [rad]; joints that it does not name are where they were,
            at first in the standing pose. A name without its side is the left joint, and the
            right one does the same in the mirror.

    Raises:
        ValueError: on a posture that is missing, a joint that there is not, or no time.
    """
    if set(table) != set(POSTURES) or not all(table.values()):
        raise ValueError(f"rises must have keyframes for {', '.join(POSTURES)}, got {list(table)}.")
    most = max(len(keyframes) for keyframes in table.values())
    keyframes, ends = torch.empty(len(POSTURES), most, len(robot.joints)), []
    for number, posture in enumerate(POSTURES):
        times, pose = [], list(robot.stand_position)
        for k, keyframe in enumerate(table[posture]):
            where = f"rises.{posture}[{k}]"
            if not keyframe.get("seconds", 0.0) > 0:
                raise ValueError(
                    f"{where}.seconds must be positive, got {keyframe.get('seconds')}."
                )
            times.append(keyframe["seconds"])
            for name, angle in keyframe.items():
                if name != "seconds":
                    _pose(robot, pose, name, float(angle), where)
            keyframes[number, k:] = torch.tensor(pose)
        times += [0.0] * (most - len(times))
        ends.append(np.cumsum(times))
    return Rises(keyframes, torch.tensor(np.array(ends)).float())


def _pose(robot: Robot, pose: list[float], name: str, angle: float, where: str) -> None:
    """Sets a joint of a pose, or the joints of both sides."""
    joints = robot.joints
    both = f"left_{name}"
    if name not in joints and both not in joints:
        raise ValueError(f"{where} must name joints of {robot.name}, got {name}.")
    left = joints.index(name if name in joints else both)
    pose[left] = angle
    if name not in joints:
        right = robot.mirror_index[left]
        pose[right] = robot.mirror_sign[right] * angle
