"""A jump of the base's velocity, for comparison with others."""

from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
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
from zfall.envs.transforms.values import NOT_NEGATIVE, reset_rows
from zfall.values import NotNegative, NotNegativeBounds, Positive, Times


class VelocityKick(Transform):
    """Changes the base's velocity at once, which no force does: what other frameworks call a push.

    The whole robot moves on with the base, joints as they were, so the momentum gained is about
    mass x kick. Kept for comparison; ``RandomPush`` is the honest disturbance.

    Keys: adds to ``("push", "kick")`` ``(N, 3)`` [m/s; world], which the base env adds to the
    base's velocity before the coming step; writes ``("push", "velocity_kick")`` ``(N, 3)``, the
    kick at the beginning of the step just taken.

    Args:
        env: the base env.
        velocity: smallest and largest change of speed [m/s].
        interval, mean_interval, times, direction: as in ``RandomPush``; a kick comes at the
            beginning of the control step in which it is due.

    Raises:
        ValueError: as ``RandomPush``.
    """

    start: Tensor
    kick: Tensor
    count: Tensor

    limits = {"velocity": NOT_NEGATIVE, "timing": NOT_NEGATIVE}

    replaced_in_batteries = True  # by pushes of a battery

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        velocity: NotNegativeBounds,
        interval: Times | None = None,
        mean_interval: Positive | None = None,
        times: Sequence[NotNegative] | None = None,
        direction: str | Sequence[float] = "planar",
    ):
        key = ("push", "kick")
        super().__init__(in_keys_inv=[key], out_keys_inv=[key])
        needs_env(self, env, "physics to act on")
        check_range("velocity", velocity)
        heading(direction, np.zeros((2, 1), np.float32))  # refuses a bad one
        self.timing = Timing(
            interval, mean_interval, times, longest=0.0, mean=0.0, control_dt=env.control_dt
        )
        self.velocity, self.direction = velocity, direction
        self.control_dt, num = env.control_dt, env.num_envs
        self.register_buffer("start", torch.full((num,), torch.inf, dtype=torch.float64))
        self.register_buffer("kick", torch.zeros(num, 3))  # the next one [m/s]
        self.register_buffer("count", torch.zeros(num, dtype=torch.long))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        base_env_of(self)
        due = self.start < self.control_dt - 1e-9
        kick = torch.where(due[:, None], self.kick, 0.0)
        there = tensordict.get(("push", "kick"), None)
        tensordict["push", "kick"] = kick if there is None else there + kick
        self.start.sub_(self.control_dt)
        self.count.add_(due)
        self._draw(due, self.start)
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(("push", "velocity_kick"), tensordict["push", "kick"])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.count.masked_fill_(rows, 0)
        self._draw(rows, torch.zeros_like(self.start))
        return tensordict_reset.set(("push", "velocity_kick"), torch.zeros_like(self.kick))

    def _draw(self, rows: Tensor, last: Tensor) -> None:
        """Plans the next kick of the worlds in ``rows``, whose last one began at ``last``."""
        index, u = uniform(4, rows, streams_of(self))
        start = self.timing.next(index, u[0], last, last, self.count)
        speed = between(of_worlds(self.velocity, index), u[1])
        self.start.numpy()[index] = start.clip(0.0)
        self.kick.numpy()[index] = speed[:, None] * heading(self.direction, u[2:])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        observation_spec["push", "velocity_kick"] = Unbounded(self.kick.shape)
        return observation_spec
