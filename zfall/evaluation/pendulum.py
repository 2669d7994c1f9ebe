"""How large a push a linear inverted pendulum withstands, and what other robots did."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from zfall.robots import GRAVITY, Robot
from zfall.robots.units import factor
from zfall.simulation.model import compile_model

Array = NDArray[np.float64]

STEP_LENGTH, STEP_TIME, FOOT_RADIUS = 0.2, 0.15, 0.05  # of the default robot's walk [m, s, m]
ATALANTE, ICUB = 0.26, 0.54  # largest pushes recovered from, over their f: fore-aft; anywhere
CAPTION = (
    "Pendulum: linear, no arms, pushed at its center of mass for as long. Atalante (fore and aft) "
    "and iCub: published, at their pelvis, impulse scaled to the same duration."
)


@dataclass(frozen=True)
class Reference:
    """A line of a polar plot: ``angle`` [rad] and dimensionless ``impulse`` of its points.

    ``point``: where the robot was pushed; ``None`` of a bound that knows no such place.
    """

    name: str
    angle: Array
    impulse: Array
    point: str | None = None


def duration_factor(duration: float, com_height: float) -> float:
    """By how much a steady push may be larger than a sudden one, ``w T / (1 - exp(-w T))``.

    Args:
        duration: T of the push [s].
        com_height: of the pendulum [m]; ``w = sqrt(g / h)``.
    """
    phase = (GRAVITY / com_height) ** 0.5 * duration
    return float(phase / -np.expm1(-phase))


def stand_support(robot: Robot) -> Array:
    """Corners of both soles in the standing pose ``(8, 2)``, from the center of mass [m]."""
    model = compile_model(robot, physics_dt=0.004)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    length, width = robot.sole_half_size
    corners = np.array([[x, y, 0.0] for x in (-length, length) for y in (-width, width)])
    points = []
    for foot in robot.feet:
        site = data.site(int(model.sensor(f"feet_position/{foot}").objid[0]))
        points.append(site.xpos + corners @ site.xmat.reshape(3, 3).T)
    return np.concatenate(points)[:, :2] - data.subtree_com[0, :2]


def no_step_bound(robot: Robot, angle: ArrayLike, duration: float) -> Array:
    """Largest dimensionless impulse that needs no step, by direction ``(K,)``.

    The capture point moves by ``I h`` under a sudden push; it must stay within the support
    polygon, whose edge the center of pressure can reach. Arms and trunk are at rest.

    Args:
        robot: gives the feet, as they stand.
        angle: directions ``(K,)`` [rad].
        duration: of the push [s].

    Source: Koolen et al., "Capturability-based analysis and control of legged locomotion, part
    1", IJRR 2012.
    """
    edges = ConvexHull(stand_support(robot)).equations  # n . x + c <= 0 inside
    heading = np.asarray(angle)
    unit = np.stack([np.cos(heading), np.sin(heading)], -1)
    along = unit @ edges[:, :2].T
    reach = np.where(along > 1e-9, -edges[:, 2] / np.maximum(along, 1e-9), np.inf).min(1)
    return reach / robot.com_height * duration_factor(duration, robot.com_height)


def endless_stepping_bound(
    robot: Robot, duration: float, *, delay: float = 0.0, step_length: float | None = None
) -> float:
    """Largest dimensionless impulse that steps without end can take up, in any direction.

    With steps of length l and time T and feet of radius r the capture point may be
    ``d = l e^(-w T) / (1 - e^(-w T)) + r`` ahead (Koolen et al. 2012); the push's velocity is w d.
    While the first step waits, the center of pressure is at the edge of the foot, and what is
    ahead of that edge grows, so that less may be at first: ``d`` is ``r + (d - r) e^(-w delay)``.

    Args:
        robot: gives the height of the center of mass, and by it time and feet of the walk.
        duration: of the push [s].
        delay: from the push to the beginning of the first step [s].
        step_length: l [m]; ``None``: 0.2 m on the default robot, and in proportion on others.
    """
    length, time = factor(robot, "length"), factor(robot, "time")
    step_length = STEP_LENGTH * length if step_length is None else step_length
    omega = (GRAVITY / robot.com_height) ** 0.5
    decay = np.exp(-omega * STEP_TIME * time)
    ahead = step_length * decay / (1.0 - decay)  # of the edge of the foot
    distance = ahead * np.exp(-omega * delay) + FOOT_RADIUS * length
    return float(distance / robot.com_height) * duration_factor(duration, robot.com_height)


def references(robot: Robot, duration: float) -> list[Reference]:
    """Lines to compare a battery with, for pushes of its duration [s]."""
    around = np.linspace(0.0, 2 * np.pi, 145)
    longer = duration_factor(duration, robot.com_height)
    sagittal = np.array([0.0, np.pi])
    return [
        Reference("pendulum, no step", around, no_step_bound(robot, around, duration)),
        Reference(
            "pendulum, endless steps",
            around,
            np.full_like(around, endless_stepping_bound(robot, duration)),
        ),
        Reference("iCub", around, np.full_like(around, ICUB * longer), "pelvis"),
        Reference("Atalante", sagittal, np.full_like(sagittal, ATALANTE * longer), "pelvis"),
    ]
