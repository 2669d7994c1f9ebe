"""A ball thrown at the robot."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env, streams_of
from zfall.envs.transforms.pushes.draws import (
    Timing,
    between,
    check_range,
    heading,
    of_worlds,
    uniform,
)
from zfall.envs.transforms.values import NOT_NEGATIVE, POSITIVE, per_world, reset_rows
from zfall.robots import GRAVITY
from zfall.values import Bounds, NotNegative, Positive, PositiveBounds, Times


class ThrownBall(Transform):
    """Throws the env's ball at the robot, at random times and from random sides.

    The ball flies freely: it starts at a distance, level with its aim, with the velocity that
    carries it there in a parabola. What it does to the robot is left to the contact.

    Keys: writes ``("ball", "launch")`` ``(N, 1)`` bool and ``("ball", "start")`` ``(N, 6)``,
    position [m] and velocity [m/s; world], which the base env puts the ball into before the
    step. Reads ``com_position`` [m].

    Args:
        env: the base env, built with a ``ball``.
        speed: smallest and largest level speed [m/s].
        distance: from the center of mass to the launch [m].
        aim: lowest and highest point aimed at, above the center of mass [m].
        interval, mean_interval, times: as in ``RandomPush``; a throw begins with a control step.

    Raises:
        ValueError: if the env has no ball, on a bad range, or not just one timing.
    """

    start: Tensor
    plan: Tensor
    count: Tensor

    limits = {"speed": POSITIVE, "timing": NOT_NEGATIVE}

    replaced_in_batteries = True  # by pushes of a battery

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        speed: PositiveBounds,
        distance: Positive = 1.0,
        aim: Bounds = (0.0, 0.1),
        interval: Times | None = None,
        mean_interval: Positive | None = None,
        times: Sequence[NotNegative] | None = None,
    ):
        keys = [("ball", "launch"), ("ball", "start")]
        super().__init__(in_keys_inv=keys, out_keys_inv=keys)
        needs_env(self, env, "physics to act on")
        if env.ball is None:
            raise ValueError(
                "ThrownBall must have a ball to throw: give base_env.ball, for instance "
                "{_target_: zfall.robots.Ball, mass: 0.2, radius: 0.04}; got none."
            )
        check_range("speed", speed, positive=True)
        check_range("aim", aim, negative=True)
        if not distance > 0:
            raise ValueError(f"distance must be positive, got {distance}.")
        self.timing = Timing(
            interval, mean_interval, times, longest=0.0, mean=0.0, control_dt=env.control_dt
        )
        self.speed, self.distance, self.aim = speed, distance, aim
        self.control_dt, num = env.control_dt, env.num_envs
        self.register_buffer("start", torch.full((num,), torch.inf, dtype=torch.float64))
        self.register_buffer("plan", torch.zeros(num, 5))  # from where (3), speed, aim
        self.register_buffer("count", torch.zeros(num, dtype=torch.long))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        base_env_of(self)
        due = self.start < self.control_dt - 1e-9
        side, speed, aim = self.plan[:, :3], self.plan[:, 3:4], self.plan[:, 4]
        target = tensordict["com_position"].clone()
        target[:, 2] += aim
        position = target + per_world(self.distance, 2) * side
        velocity = -speed * side
        velocity[:, 2] += 0.5 * GRAVITY * self.distance / speed[:, 0]  # level at half the flight
        start = torch.cat([position, velocity], -1)
        there = tensordict.get(("ball", "launch"), None)
        if there is not None:  # of another transform, with the same ball
            start = torch.where(due[:, None], start, tensordict["ball", "start"])
        tensordict["ball", "launch"] = due[:, None] if there is None else there | due[:, None]
        tensordict["ball", "start"] = start
        self.start.sub_(self.control_dt)
        self.count.add_(due)
        self._draw(due, self.start)
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.count.masked_fill_(rows, 0)
        self._draw(rows, torch.zeros_like(self.start))
        return tensordict_reset

    def _draw(self, rows: Tensor, last: Tensor) -> None:
        """Plans the next throw of the worlds in ``rows``, whose last one began at ``last``."""
        index, u = uniform(4, rows, streams_of(self))
        start = self.timing.next(index, u[0], last, last, self.count)
        self.start.numpy()[index] = start.clip(0.0)
        plan = self.plan.numpy()
        plan[index, :3] = heading("planar", u[3:])
        plan[index, 3] = between(of_worlds(self.speed, index), u[1])
        plan[index, 4] = between(of_worlds(self.aim, index), u[2])
