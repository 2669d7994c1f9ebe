"""What a term of another framework is, and what it is given."""

from dataclasses import dataclass
from typing import Protocol

from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.transforms.foreign.joints import places
from zfall.envs.transforms.observations.measured import read_measured
from zfall.robots import Robot
from zfall.values import Names


@dataclass(frozen=True)
class Seen:
    """What a term is given of N worlds.

    Attributes:
        tensordict: what the env wrote in this step.
        robot: the robot.
        joints: places of the policy's joints in the robot's order ``(A,)``.
        reference: the pose that positions start from ``(J,)`` [rad].
        base_com: center of mass of the base link, in its axes ``(3,)`` [m].
        steps: control steps since the reset ``(N, 1)``.
        control_dt: of one of them [s].
        actions: those of the steps before ``(N, MOST_ACTIONS, A)``, the newest first, 0 before the
            first.
    """

    tensordict: TensorDictBase
    robot: Robot
    joints: Tensor
    reference: Tensor
    base_com: Tensor
    steps: Tensor
    control_dt: float
    actions: Tensor

    def __getitem__(self, key: str) -> Tensor:
        """A quantity as it was measured, else its true value; float32."""
        return read_measured(self.tensordict, key)

    def places(self, names: Names | None) -> Tensor:
        """Places of joints in the robot's order; those of the policy if ``None``."""
        return self.joints if names is None else places(self.robot, names)


MOST_ACTIONS = 2  # of the steps before, that a term may look back at


class Term(Protocol):
    """What a term is.

    Attributes:
        reads: quantities that it reads.
    """

    reads: tuple[str, ...]

    def __call__(self, seen: Seen) -> Tensor:
        """Its numbers ``(N, size)``."""
