"""How well a walking robot does what it is told."""

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.followers import Ended, Moment
from zfall.rotations import heading, turn_to_heading, wrap


class CommandFollowing:
    """Compares how the base moves with the ``command``, until a trial ends or the robot falls.

    ``velocity_forward``, ``velocity_left`` [m/s] and ``yaw_rate`` [rad/s]: means from the
    battery's ``push_time`` on, along the heading; the sway of a gait cancels in them.
    ``velocity_error`` [m/s]: how far the mean velocity is from the mean command. ``yaw_rate_error``
    [rad/s]: the same of the turning. ``heading_error`` [rad]: how far the robot has turned from
    its first step on, less what it should have, at the end; whole turns count.

    Where ``commanded_heading`` is not given, the third number of the command is the heading.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: HumanoidEnv):
        n = env.num_envs
        self.control_dt = env.control_dt
        self.steps = torch.zeros(n)
        self.moved, self.wanted = torch.zeros(n, 3), torch.zeros(n, 3)  # sums over steps
        self.turn, self.wanted_turn = torch.zeros(n), torch.zeros(n)  # since the first step
        self._headings: Tensor | None = None  # of the step before: real, wanted

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step before ``push_time``, in which only turning counts."""
        self._turns(td, now)

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step."""
        turned = self._turns(td, now)
        velocity = turn_to_heading(td["base_orientation"], td["base_linear_velocity"][:, :2])
        counted = now.upto_fall.float()[:, None]
        rates = turned / self.control_dt
        self.steps += counted[:, 0]
        self.moved += counted * torch.cat([velocity, rates[:, :1]], -1)
        self.wanted += counted * torch.cat([td["command"][:, :2], rates[:, 1:]], -1)

    def _turns(self, td: TensorDictBase, now: Moment) -> Tensor:
        """By how much it turned and should have in this step ``(N, 2)`` [rad]."""
        wanted = td.get("commanded_heading", td["command"][:, 2:3])
        headings = torch.cat([heading(td["base_orientation"]), wanted], -1)
        last = torch.zeros_like(headings) if self._headings is None else self._headings
        turned = wrap(headings - last)
        self._headings = headings.clone()
        self.turn += now.upto_fall * turned[:, 0]
        self.wanted_turn += now.upto_fall * turned[:, 1]
        return turned

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Columns ``(N,)``; NaN for a trial that was over before ``push_time``."""
        moved, wanted = self.moved / self.steps[:, None], self.wanted / self.steps[:, None]
        error = moved - wanted
        turn = (self.turn - self.wanted_turn).abs()
        return {
            "velocity_forward": moved[:, 0],
            "velocity_left": moved[:, 1],
            "yaw_rate": moved[:, 2],
            "velocity_error": error[:, :2].norm(dim=-1),
            "yaw_rate_error": error[:, 2].abs(),
            "heading_error": torch.where(self.steps > 0, turn, torch.nan),
        }
