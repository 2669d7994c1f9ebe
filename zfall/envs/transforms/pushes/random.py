"""Pushes at random times, of random size and heading."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
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
from zfall.envs.transforms.pushes.force import PushForces
from zfall.envs.transforms.values import NOT_NEGATIVE, POSITIVE, reset_rows
from zfall.values import (
    Bounds,
    Count,
    NotNegative,
    NotNegativeBounds,
    Positive,
    PositiveBounds,
    Times,
)


class RandomPush(Transform):
    """Pushes every world at random times with a random force; one push at a time.

    Sums over physics steps of force x time are the impulse at any control and physics rate: each
    physics step carries the share of the profile that falls into it. Several of these add up.

    Keys: adds to ``("push", "wrench")`` ``(N, S, bodies, 6)`` [N, N m; world]. Writes what acted
    in the step just taken, zero without a push: ``("push", "force")`` ``(N, 3)``, its mean over
    the step [N; world]; and, of the whole push, ``("push", "peak_force")`` [N], ``("push",
    "impulse")`` [N s] and ``("push", "size")`` ``(N, 1)``, the dimensionless impulse.

    Args:
        env: the base env.
        point: where it acts: a push point or a link, see ``HumanoidEnv.push_targets``; of
            several each push takes one at random.
        duration: length of a push [s], or the shortest and the longest.
        interval: shortest and longest rest before a push [s], the first one included; or
        mean_interval: mean time from push to push [s]; the rests are exponential, which makes a
            Poisson process but for the time that a push takes; or
        times: when pushes begin [s since the episode began].
        force: smallest and largest peak force [N]; or
        impulse: smallest and largest impulse [N s]; or
        size: smallest and largest dimensionless impulse, ``impulse / (m sqrt(g h0))``; or
        axes: smallest and largest peak force along ``x``, ``y`` and ``z`` [N], each drawn on its
            own; what is not named is 0.
        direction: ``planar``, level with a uniform heading; ``spherical``, uniform on the
            sphere; or a fixed vector ``[x, y, z]`` in world axes. Not with ``axes``.
        sectors: number of equal parts of the circle, the first one centred on x; each world has
            one of them, from which all its planar pushes come. A ``Curriculum``, which has a level
            for each world, then makes each direction as hard as it is mastered. ``None``: all
            worlds are pushed from everywhere.
        profile: how the force goes over the duration: ``rectangular``, ``half_sine``,
            ``gaussian`` or ``ramp``.

    Raises:
        ValueError: on an unknown point, direction or profile, a bad range, or not just one of
            the three timings and of the four measures of strength.
    """

    start: Tensor
    duration_now: Tensor
    force_now: Tensor
    point_now: Tensor
    count: Tensor

    limits = dict.fromkeys(("force", "impulse", "size", "timing"), NOT_NEGATIVE) | {
        "duration": POSITIVE
    }

    replaced_in_batteries = True  # by pushes of a battery

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        point: str | Sequence[str],
        duration: Positive | PositiveBounds,
        interval: Times | None = None,
        mean_interval: Positive | None = None,
        times: Sequence[NotNegative] | None = None,
        force: NotNegativeBounds | None = None,
        impulse: NotNegativeBounds | None = None,
        size: NotNegativeBounds | None = None,
        axes: Mapping[str, Bounds] | None = None,
        direction: str | Sequence[float] = "planar",
        sectors: Count | None = None,
        profile: str = "rectangular",
    ):
        super().__init__(in_keys_inv=[("push", "wrench")], out_keys_inv=[("push", "wrench")])
        needs_env(self, env, "physics to act on")
        points = [point] if isinstance(point, str) else list(point)
        self.forces = PushForces(env, points, profile)
        self.duration = [duration] * 2 if isinstance(duration, (int, float)) else duration
        check_range("duration", self.duration, positive=True)
        self.duration = list(self.duration)
        self.timing = Timing(
            interval,
            mean_interval,
            times,
            longest=self.duration[1],
            mean=0.5 * sum(self.duration),
            control_dt=env.control_dt,
        )
        self.not_movable = () if interval is not None else ("duration",)
        measures = {"force": force, "impulse": impulse, "size": size, "axes": axes}
        given = [name for name, value in measures.items() if value is not None]
        if len(given) != 1:
            raise ValueError(
                f"give just one of {', '.join(measures)}, got {', '.join(given) or 'none'}."
            )
        self.measure = given[0]
        if axes is not None:
            unknown = sorted(set(axes) - set("xyz"))
            if unknown:
                raise ValueError(f"axes must be of x, y and z, got {unknown[0]!r}.")
            for axis, bounds in axes.items():
                check_range(f"axes.{axis}", bounds, negative=True)
            axes = {axis: list(axes.get(axis, [0.0, 0.0])) for axis in "xyz"}
        else:
            values: Any = measures[self.measure]
            check_range(self.measure, values)
            heading(direction, np.zeros((2, 1), np.float32))  # refuses a bad one
        # Kept as given, in its own unit, so that a curriculum can move it.
        self.force, self.impulse, self.size, self.axes = force, impulse, size, axes
        if sectors is not None and (direction != "planar" or axes is not None or sectors < 1):
            raise ValueError(
                f"sectors must be null, or 1 and more for planar directions, got {sectors}."
            )
        self.direction, self.sectors = direction, sectors
        self.control_dt, self.impulse_unit = env.control_dt, env.robot.impulse_unit
        num = env.num_envs
        self.register_buffer("start", torch.full((num,), torch.inf, dtype=torch.float64))
        self.register_buffer("duration_now", torch.full((num,), self.duration[1]))  # of the next
        self.register_buffer("force_now", torch.zeros(num, 3))  # its peak [N]
        self.register_buffer("point_now", torch.zeros(num, dtype=torch.long))
        self.register_buffer("count", torch.zeros(num, dtype=torch.long))  # pushes of the episode

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        plan = (self.start, self.duration_now, self.force_now, self.point_now)
        self.forces.apply(base_env_of(self), tensordict, *(value[:, None] for value in plan))
        self.start.sub_(self.control_dt)
        end = self.start + self.duration_now
        over = end <= 0
        self.count.add_(over)
        self._draw(over, end, self.start)
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self.forces.observe(next_tensordict)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.count.masked_fill_(rows, 0)
        zero = torch.zeros_like(self.start)
        self._draw(rows, zero, zero)
        self.forces.clear(tensordict_reset)
        return tensordict_reset

    def _draw(self, rows: Tensor, rest_from: Tensor, last: Tensor) -> None:
        """Plans the next push of the worlds in ``rows``.

        Args:
            rows: which worlds ``(N,)`` bool.
            rest_from: since when they rest ``(N,)`` [s from now].
            last: when the push before began ``(N,)``, or the episode [s from now].
        """
        index, u = uniform(7, rows, streams_of(self))
        start = self.timing.next(index, u[0], rest_from, last, self.count)
        duration = between(of_worlds(self.duration, index), u[1])
        self.start.numpy()[index] = start.clip(0.0)
        self.duration_now.numpy()[index] = duration
        self.point_now.numpy()[index] = u[2] * len(self.forces.bodies)  # the whole part of it
        self.force_now.numpy()[index] = self._force(u[3:], duration, index)

    def _force(
        self, u: NDArray[np.float32], duration: NDArray[np.float32], index: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """Peak forces ``(K, 3)`` [N; world] of the worlds in ``index``, from ``(4, K)``."""
        if self.axes is not None:
            axes = [of_worlds(self.axes[axis], index) for axis in "xyz"]
            return np.stack([between(*pair) for pair in zip(axes, u[:3], strict=True)], -1)
        strength = between(of_worlds(getattr(self, self.measure), index), u[0])
        if self.measure != "force":
            strength = strength / (self.forces.profile.mean * duration)
        if self.measure == "size":
            strength = strength * self.impulse_unit
        if self.sectors is not None:
            part = (index % self.sectors + u[1] - 0.5) / self.sectors
            u = np.stack([u[0], part.astype(np.float32), u[2]])
        return strength[:, None] * heading(self.direction, u[1:3])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        self.forces.specify(observation_spec)
        return observation_spec
