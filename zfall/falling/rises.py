"""Movements that get up, and where they are stored."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from zfall.arrays import arrays_of
from zfall.falling.files import own_file
from zfall.falling.lying import POSTURES
from zfall.robots import Robot

GOALS = ("stand", "belly")


class Rises(NamedTuple):
    """Movements: keyframes to go through, by how the robot lies or kneels.

    A movement begins where the target is and goes from keyframe to keyframe in straight lines.

    Attributes:
        names: of the R movements.
        posture: position in ``POSTURES`` of that which each is for ``(R,)``.
        begins: angles at which each is at its best ``(R, J)`` [rad]; NaN: any.
        goal: position in ``GOALS`` of where each leads to ``(R,)``.
        keyframes: ``(R, K, J)`` [rad]; shorter movements repeat the last.
        ends: when each keyframe is reached, from the begin of the movement ``(R, K)`` [s].
    """

    names: tuple[str, ...]
    posture: Tensor
    begins: Tensor
    goal: Tensor
    keyframes: Tensor
    ends: Tensor

    def choose(self, posture: Tensor, joint_position: Tensor) -> Tensor:
        """Movements for postures ``(N,)`` and joint angles ``(N, J)`` [rad], the nearest ``(N,)``.

        Of the movements for the posture it is the one with the smallest mean square distance of
        the angles from those in ``begins`` that are not NaN.
        """
        away = (joint_position[:, None] - self.begins).square().nanmean(-1).nan_to_num(0.0)
        return away.masked_fill(posture[:, None] != self.posture, torch.inf).argmin(-1)

    def target(self, number: Tensor, begin: Tensor, time: Tensor) -> Tensor:
        """The targets ``(N, J)`` [rad] at a time of the movement.

        Args:
            number: movement of each world ``(N,)``.
            begin: target where the movement began ``(N, J)`` [rad].
            time: since then ``(N,)`` [s].
        """
        ends, keyframes = self.ends[number], self.keyframes[number]
        rows, last = torch.arange(len(time)), ends.shape[1] - 1
        phase = (ends <= time[:, None] + 1e-6).sum(1).clamp(max=last)
        first = phase == 0
        start = torch.where(first, 0.0, ends[rows, phase - 1])
        before = torch.where(first[:, None], begin, keyframes[rows, phase - 1])
        took = (ends[rows, phase] - start).clamp_min(1e-6)
        share = ((time - start) / took).clamp(0.0, 1.0)
        return before + share[:, None] * (keyframes[rows, phase] - before)

    def over(self, number: Tensor, time: Tensor) -> Tensor:
        """Whether the movements have reached their last keyframe ``(N,)`` bool."""
        return time > self.ends[number, -1] - 1e-6


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
        names = tuple(str(name) for name in file["names"])
        posture, goal = (torch.from_numpy(file[key]).long() for key in ("posture", "goal"))
        begins, keyframes, ends = (
            torch.from_numpy(file[key]).float() for key in ("begins", "keyframes", "ends")
        )
    count, joints = len(names), len(robot.joints)
    shapes = [tuple(x.shape) for x in (posture, goal, begins, keyframes)]
    if shapes != [(count,), (count,), (count, joints), (*ends.shape, joints)]:
        raise ValueError(f"rises must be of {robot.name}, {path} has other joints or movements.")
    if not (keyframes.isfinite().all() and (ends > 0).all() and (ends.diff(dim=1) >= 0).all()):
        raise ValueError(f"rises must have finite angles at rising times, {path} has others.")
    if set(posture.tolist()) != set(range(len(POSTURES))):
        raise ValueError(f"rises must have a movement for each posture, {path} lacks some.")
    return Rises(names, posture, begins, goal, keyframes, ends)


def save_rises(path: Path, rises: Rises) -> None:
    """Writes a file that ``load_rises`` reads."""
    arrays: dict[str, Any] = {
        key: value.numpy() for key, value in rises._asdict().items() if key != "names"
    }
    np.savez_compressed(path, names=np.array(rises.names), **arrays)


def written_rises(robot: Robot, table: Mapping[str, Mapping[str, Any]]) -> Rises:
    """Movements that are written as a table.

    Args:
        robot: whose joints they are.
        table: movements by name. Each has ``posture``, one of ``POSTURES``; ``goal``, one of
            ``GOALS``; and ``keyframes``. A keyframe has ``seconds``, how long the way to it takes,
            and angles by joint [rad]; joints that it does not name are where they were, at first
            in the standing pose. A name without its side is the left joint, and the right one does
            the same in the mirror. ``begins``, where there is one, has such angles, too.

    Raises:
        ValueError: on an unknown posture, goal or joint, a keyframe without a time, or a posture
            without a movement.
    """
    postures, goals, begins, poses, ends = [], [], [], [], []
    for name, movement in table.items():
        for key, known in (("posture", POSTURES), ("goal", GOALS)):
            if movement.get(key) not in known:
                raise ValueError(
                    f"movements.{name}.{key} must be one of {', '.join(known)}, "
                    f"got {movement.get(key)}."
                )
        postures.append(POSTURES.index(movement["posture"]))
        goals.append(GOALS.index(movement["goal"]))
        begin = [np.nan] * len(robot.joints)
        for joint, angle in movement.get("begins", {}).items():
            _pose(robot, begin, joint, angle, f"movements.{name}.begins")
        begins.append(begin)
        pose, own, times = list(robot.stand_position), [], []
        for k, keyframe in enumerate(movement.get("keyframes", ())):
            where = f"movements.{name}.keyframes[{k}]"
            if not keyframe.get("seconds", 0.0) > 0:
                raise ValueError(f"{where} must have positive seconds, got {dict(keyframe)}.")
            times.append(keyframe["seconds"])
            for joint, angle in keyframe.items():
                if joint != "seconds":
                    _pose(robot, pose, joint, angle, where)
            own.append(list(pose))
        if not own:
            raise ValueError(f"movements.{name}.keyframes must hold at least one, got none.")
        poses.append(own)
        ends.append(np.cumsum(times).tolist())
    if missing := [name for i, name in enumerate(POSTURES) if i not in postures]:
        raise ValueError(f"movements must have one for each posture, got none for {missing[0]}.")
    most = max(map(len, poses))
    keyframes = torch.tensor([own + own[-1:] * (most - len(own)) for own in poses])
    times_of = torch.tensor([own + own[-1:] * (most - len(own)) for own in ends])
    numbers = torch.tensor(postures), torch.tensor(begins), torch.tensor(goals)
    return Rises(tuple(table), *numbers, keyframes, times_of)


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
