"""Terms for going down on the knees, and for resting there.

Source: the kneel rewards in the design notes of the Zeroth-fall project, which name the terms and
their weights; kernels and scales are ours.
"""

from collections.abc import Callable
from typing import Annotated

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.terms.falls import body_contact
from zfall.falling.kneels import kneels_of
from zfall.robots import GRAVITY, Robot
from zfall.rotations import tilt
from zfall.values import (
    Names,
    NamesOf,
    NotNegative,
    NotNegativeOrInfinite,
    Positive,
    PositiveOrInfinite,
    Rule,
)

Mode = Annotated[
    int, Rule("be 0 (recover), 1 (kneel), 2 (stable) or 3 (rise)", lambda x: x in (0, 1, 2, 3))
]
Regions = Annotated[Names, NamesOf("regions, of both sides", lambda robot: _regions(robot))]


def _regions(robot: Robot) -> list[str]:
    """Names of regions, those of a left and a right one without the side."""
    return list(dict.fromkeys(region.split("_")[-1] for region in robot.regions))


def regions_named(robot: Robot, *names: str) -> list[int]:
    """Positions in ``regions`` of those with one of the names, left and right."""
    return [i for i, region in enumerate(robot.regions) if region.split("_")[-1] in names]


def _of_mode(mode: Mode, td: TensorDictBase) -> Tensor:
    """Where a one-hot ``mode`` ``(*B, M)`` is this one ``(*B, 1)``.

    Raises:
        ValueError: if the machine has no such mode.
    """
    modes = td["mode"]
    if mode >= modes.shape[-1]:
        raise ValueError(f"mode must be below {modes.shape[-1]} without rise, got {mode}.")
    return modes[..., mode : mode + 1]


def touching(next_td: TensorDictBase, robot: Robot, *names: str) -> Tensor:
    """Whether any region with one of the names touched the floor during the step ``(*B, 1)``.

    Reads ``contact_force_peak`` ``(*B, R)`` [N].
    """
    force = next_td["contact_force_peak"][..., regions_named(robot, *names)]
    return (force > 0).any(-1, keepdim=True)


def resting_kneel(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    angle: float = 0.6,
    speed: float = 0.1,
    joint_speed: float = 0.1,
) -> Tensor:
    """Whether the robot rests on its knees, torso and head off the floor, upright.

    It rests if the base is slower than ``speed`` [m/s and rad/s] and all joints are slower than
    ``joint_speed`` [rad/s], and is upright if it leans by less than ``angle`` [rad]. A stable kneel
    is half a second of this.

    Reads ``contact_force_peak`` [N], ``base_orientation``, ``base_linear_velocity`` [m/s],
    ``base_angular_velocity`` and ``joint_velocity`` [rad/s]. Returns ``(*B, 1)`` bool.
    """
    slow = _slow(next_td, speed, joint_speed)
    upright = tilt(next_td["base_orientation"]) < angle
    down = touching(next_td, robot, *kneels_of(robot).regions)
    off = ~touching(next_td, robot, "torso", "head")
    return (slow & upright)[..., None] & down & off


def lying_still(
    td: TensorDictBase, next_td: TensorDictBase, *, speed: float = 0.1, joint_speed: float = 0.1
) -> Tensor:
    """Whether the robot rests on anything but its feet alone, lying or kneeling.

    It rests if the base is slower than ``speed`` [m/s and rad/s] and all joints are slower than
    ``joint_speed`` [rad/s].

    Reads ``contact_force_peak`` [N], ``base_linear_velocity`` [m/s], ``base_angular_velocity`` and
    ``joint_velocity`` [rad/s]. Returns ``(*B, 1)`` bool.
    """
    return _slow(next_td, speed, joint_speed)[..., None] & body_contact(td, next_td)


def _slow(td: TensorDictBase, speed: float, joint_speed: float) -> Tensor:
    slow = td["base_linear_velocity"].norm(dim=-1) < speed
    slow &= td["base_angular_velocity"].norm(dim=-1) < speed
    return slow & (td["joint_velocity"].abs().amax(-1) < joint_speed)


def in_mode(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    mode: Mode,
    term: Callable[..., Tensor],
) -> Tensor:
    """The value of another term in the worlds that acted in a mode, 0 (or false) in the others.

    Reads ``mode`` ``(*B, 3)`` before the step, and what the term reads. Returns ``(*B, 1)``.
    """
    value = term(td, next_td)
    return torch.where(_of_mode(mode, td) > 0, value, torch.zeros_like(value))


def in_slow_fall(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    below: NotNegativeOrInfinite,
    term: Callable[..., Tensor],
) -> Tensor:
    """The value of another term in falls slower than ``below`` [m/s], 0 (or false) in the others.

    Reads ``falling_speed`` ``(*B, 1)`` [m/s], which ``FallingStart`` writes, and what the term
    reads. Without that key, where no episode begins in a fall, the term counts. Returns
    ``(*B, 1)``.
    """
    value, speed = term(td, next_td), next_td.get("falling_speed", None)
    return value if speed is None else torch.where(speed < below, value, torch.zeros_like(value))


def com_lowering(td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot) -> Tensor:
    """Share of the way from standing to two thirds of the height, ``clip(3 (1 - z / h0), 0, 1)``.

    Reads ``com_position`` ``(*B, 3)`` [m]. Returns ``(*B, 1)``.
    """
    height = next_td["com_position"][..., 2:] / robot.com_height
    return (3.0 * (1.0 - height)).clamp(0.0, 1.0)


def controlled_descent(td: TensorDictBase, next_td: TensorDictBase, *, sigma: Positive) -> Tensor:
    """High without shocks: ``exp(-(|a| - g)^2 / sigma^2)``, with a the largest over the step.

    Reads ``base_acceleration_peak`` ``(*B, 1)`` [m/s2]; ``sigma`` [m/s2]. Returns ``(*B, 1)`` in
    (0, 1].
    """
    excess = next_td["base_acceleration_peak"] - GRAVITY
    return torch.exp(-excess.square() / sigma**2)


def harder_landing(td: TensorDictBase, next_td: TensorDictBase, *, free: NotNegative) -> Tensor:
    """By how much the step raised the episode's hardest shock above ``free`` [m/s2].

    Over an episode the sum is the excess of the hardest shock alone, whose peak the batteries
    report; softer shocks after it cost nothing. Reads ``base_acceleration_max`` ``(*B, 1)``, which
    ``LargestSoFar`` writes. Returns ``(*B, 1)`` [m/s2].
    """
    before, after = ((x["base_acceleration_max"] - free).clamp_min(0.0) for x in (td, next_td))
    return after - before


def harder_blow(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, names: Regions
) -> Tensor:
    """By how much the step raised the episode's largest force on regions with these names [N].

    Reads ``contact_force_max`` ``(*B, R)`` [N], which ``LargestSoFar`` writes. Returns
    ``(*B, 1)`` [N].
    """
    of = regions_named(robot, *names)
    before, after = (x["contact_force_max"][..., of].amax(-1, keepdim=True) for x in (td, next_td))
    return after - before


def first_touch(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, names: Regions
) -> Tensor:
    """1 for the step in which the first region with one of the names touched the floor.

    Reads ``contact_force_max`` ``(*B, R)`` [N], which ``LargestSoFar`` writes. Returns
    ``(*B, 1)``.
    """
    of = regions_named(robot, *names)
    before, after = (
        (x["contact_force_max"][..., of] > 0).any(-1, keepdim=True) for x in (td, next_td)
    )
    return (after & ~before).float()


def kneeling(
    td: TensorDictBase,
    next_td: TensorDictBase,
    *,
    robot: Robot,
    speed: PositiveOrInfinite,
    joint_speed: PositiveOrInfinite,
    clean: bool = False,
) -> Tensor:
    """1 in a ``resting_kneel`` with these bounds.

    ``speed`` [m/s and rad/s], ``joint_speed`` [rad/s]. If ``clean``, only as long as torso and
    head have not touched the floor in this episode. Reads what ``resting_kneel`` reads and, if
    ``clean``, ``contact_force_max`` ``(*B, R)`` [N]. Returns ``(*B, 1)``.
    """
    rests = resting_kneel(td, next_td, robot=robot, speed=speed, joint_speed=joint_speed)
    if clean:
        of = regions_named(robot, "torso", "head")
        rests &= (next_td["contact_force_max"][..., of] == 0).all(-1, keepdim=True)
    return rests.float()


def low_angular_rate(td: TensorDictBase, next_td: TensorDictBase, *, sigma: Positive) -> Tensor:
    """High when the base does not turn: ``exp(-|omega|^2 / sigma^2)``.

    Reads ``base_angular_velocity`` ``(*B, 3)``; ``sigma`` [rad/s]. Returns ``(*B, 1)`` in (0, 1].
    """
    rate = next_td["base_angular_velocity"]
    return torch.exp(-rate.square().sum(-1, keepdim=True) / sigma**2)


def region_contact(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, names: Regions
) -> Tensor:
    """1 if a region with one of the names, left or right, touched the floor; ``(*B, 1)``."""
    return touching(next_td, robot, *names).float()


def region_contact_ends(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, names: Regions
) -> Tensor:
    """Condition for an end: whether such a region touched the floor; ``(*B, 1)`` bool."""
    return touching(next_td, robot, *names)


def kneel_pose(
    td: TensorDictBase, next_td: TensorDictBase, *, robot: Robot, sigma: Positive
) -> Tensor:
    """High in the robot's posture ``kneel`` or its mirror image: ``exp(-|q - q_k|^2 / sigma^2)``.

    Reads ``joint_position`` ``(*B, J)`` [rad]; ``sigma`` [rad]. Returns ``(*B, 1)`` in (0, 1].
    """
    position = next_td["joint_position"]
    pose = position.new_tensor(robot.posture("kneel"))
    mirrored = pose[list(robot.mirror_index)] * position.new_tensor(robot.mirror_sign)
    error = torch.stack([(position - p).square().sum(-1) for p in (pose, mirrored)]).amin(0)
    return torch.exp(-error[..., None] / sigma**2)


def entered_mode(td: TensorDictBase, next_td: TensorDictBase, *, mode: Mode) -> Tensor:
    """1 for the step that led into a mode; reads ``mode``; returns ``(*B, 1)``."""
    before, after = (_of_mode(mode, x) for x in (td, next_td))
    return ((after > 0) & (before == 0)).float()


def entered_mode_ends(td: TensorDictBase, next_td: TensorDictBase, *, mode: Mode) -> Tensor:
    """Condition for an end: that the step led into a mode; ``(*B, 1)`` bool."""
    return entered_mode(td, next_td, mode=mode) > 0
