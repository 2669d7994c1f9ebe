"""How hard a thrown ball hits."""

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.followers import Ended, Moment

WITHIN = 0.6  # after the push begins, in which the ball flies and hits [s]


class BallHits:
    """Follows the ball of each trial from its launch until 0.6 s later.

    ``ball_impulse``: the largest change of its level momentum, in units of m sqrt(g h0): what the
    robot, and the floor, took of it. More than what it carries if it bounces off, 0 if it missed.

    Args:
        env: the base env, with a ``ball``.
    """

    outcomes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: HumanoidEnv):
        if env.ball is None:
            raise ValueError("measures must name BallHits only where base_env has a ball.")
        self.scale = env.ball.mass / env.robot.impulse_unit
        self.largest = torch.zeros(env.num_envs)
        self._launched: Tensor | None = None  # velocity after the first step of the flight

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """No ball flies before the push."""

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step."""
        velocity = td["ball", "velocity"][:, :2]
        if self._launched is None:
            self._launched = velocity.clone()
        if now.since_push <= WITHIN:
            change = self.scale * (velocity - self._launched).norm(dim=-1)
            self.largest = torch.maximum(self.largest, torch.where(now.counted, change, 0.0))

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Its column ``(N,)``; NaN for a trial that was over before the push."""
        return {"ball_impulse": torch.where(ended.before_push, torch.nan, self.largest)}
