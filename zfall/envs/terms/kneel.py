"""How a robot goes down on its knees, and whether it rests there."""

from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.robots import Robot
from zfall.envs.rotations import tilt


def regions_named(robot: Robot, *names: str) -> list[int]:
    """Positions in ``regions`` of those with one of the names, left and right."""
    return [i for i, region in enumerate(robot.regions) if region.split("_")[-1] in names]


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
) -> Tensor:
    """Whether the robot rests on a knee or shin, its torso and head off the floor and upright.

    It rests if base and joints are slower than ``speed`` [m/s and rad/s], and is upright if it
    leans by less than ``angle`` [rad]. A stable kneel is half a second of this.

    Reads ``contact_force_peak`` [N], ``base_orientation``, ``base_linear_velocity`` [m/s],
    ``base_angular_velocity`` and ``joint_velocity`` [rad/s]. Returns ``(*B, 1)`` bool.
    """
    slow = next_td["base_linear_velocity"].norm(dim=-1) < speed
    slow &= next_td["base_angular_velocity"].norm(dim=-1) < speed
    slow &= next_td["joint_velocity"].abs().amax(-1) < speed
    upright = tilt(next_td["base_orientation"]) < angle
    down = touching(next_td, robot, "knee", "shin")
    off = ~touching(next_td, robot, "torso", "head")
    return (slow & upright)[..., None] & down & off
