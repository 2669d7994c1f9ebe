"""Banks: files with the states of robots in the midst of falls."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from zfall.arrays import arrays_of
from zfall.envs.humanoid import STATE_KEYS
from zfall.robots import Robot

PUSH_KEYS = ("push_force", "push_left")  # [N; world], [s]
# What a policy sees and the state does not contain.
SEEN_KEYS = ("target", "feet_force", "com_velocity")
# What the robot's estimators had made of it, by the name of the quantity.
ESTIMATES = {
    "measured_gravity": "projected_gravity",
    "measured_joint_velocity": "joint_velocity",
}
RATE = "control_dt"
_OF_JOINTS = ("joint_position", "joint_velocity", "target")


def save_bank(path: Path, states: Mapping[str, Tensor], *, control_dt: float | None = None) -> None:
    """Writes arrays ``(K, ...)`` float32, which ``load_bank`` reads.

    Args:
        path: of the file.
        states: by key.
        control_dt: of the policy whose falls they are [s]; ``None``: it is not said.
    """
    arrays: dict[str, Any] = {key: value.numpy() for key, value in states.items()}
    if control_dt is not None:
        arrays[RATE] = np.float64(control_dt)
    np.savez_compressed(path, **arrays)


def load_bank(
    path: Path, robot: Robot, *, needs: Sequence[str] = (), name: str = "bank"
) -> dict[str, Tensor]:
    """The K states of a bank, flat.

    Args:
        path: of the file.
        robot: whose states they are.
        needs: keys that must be there besides ``STATE_KEYS``, of ``PUSH_KEYS`` and ``SEEN_KEYS``.
        name: of the config key that names the file, for errors.

    Returns:
        ``(K, D)`` float32 under ``STATE_KEYS``, and what is there of ``PUSH_KEYS``, ``SEEN_KEYS``
        and ``ESTIMATES``: the force [N; world] of a push and the time for which it goes on [s]; the
        target of the servos [rad], the forces on the feet [N], the velocity of the center of mass
        [m/s]; as estimated, where gravity points and the speeds of the joints [rad/s].

    Raises:
        ValueError: if there is no such file, or it is of another kind or robot, or lacks a key or
            numbers.
    """
    rule = f"{name} must be a file that recipes.falling.falls wrote"
    with arrays_of(path, rule) as file:
        known = [key for key in (*STATE_KEYS, *PUSH_KEYS, *SEEN_KEYS, *ESTIMATES) if key in file]
        states = {key: torch.from_numpy(file[key]).float().flatten(1) for key in known}
    lacking = [key for key in (*STATE_KEYS, *needs) if key not in states]
    if lacking:
        raise ValueError(f"{rule}, {path} lacks {lacking[0]}: record it again.")
    if {states[key].shape[1] for key in _OF_JOINTS if key in states} != {len(robot.joints)}:
        raise ValueError(f"{name} must be of {robot.name}, {path} has other joints.")
    count = len(states["joint_position"])
    for key, value in states.items():
        if len(value) != count or not value.isfinite().all():
            raise ValueError(
                f"{name} must have {count} rows of numbers under every key, as for "
                f"joint_position; {path} does not for {key}: record it again."
            )
    return states


def bank_control_dt(path: Path, *, name: str = "bank") -> float:
    """Length of a control step of the policy whose falls a bank has [s].

    Those that were recorded before 2026-11-29 do not say it: 0.04 s.
    """
    with arrays_of(path, f"{name} must be a file that recipes.falling.falls wrote") as file:
        return float(file[RATE]) if RATE in file else 0.04
