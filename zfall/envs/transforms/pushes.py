"""Forces on the robot's body."""

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.starts import reset_rows


def force_share(begin: Tensor, physics_dt: float, start: Tensor, duration: float) -> Tensor:
    """Share of each physics step during which a push acts.

    Args:
        begin: begin of each physics step ``(S,)`` [s from now].
        physics_dt: length of a physics step [s].
        start: begin of each world's push ``(N,)`` [s from now].
        duration: its length [s].

    Returns:
        ``(N, S)`` in [0, 1]. Its sum times ``physics_dt`` is ``duration`` once the push is over,
        whatever the rates, so that the impulse is exact.
    """
    first = start[:, None]
    end = torch.minimum(begin + physics_dt, first + duration)
    return (end - torch.maximum(begin, first)).clamp_min(0.0) / physics_dt


class _Push(Transform):
    """A constant force for a time, at one point of every world; subclasses say when and what.

    Keys: adds to ``("push", "wrench")`` ``(N, S, bodies, 6)`` [N, N m; world]; writes
    ``("push", "force")`` ``(N, 3)``, the mean force over the step just taken [N; world].
    """

    begin: Tensor
    start: Tensor
    force: Tensor

    def __init__(self, env: HumanoidEnv, point: str, duration: float):
        super().__init__(in_keys_inv=[("push", "wrench")], out_keys_inv=[("push", "wrench")])
        if point not in env.push_targets:
            raise ValueError(
                f"point must be a push point or a link, one of {', '.join(env.push_targets)}; "
                f"got {point!r}."
            )
        if not duration > 0:
            raise ValueError(f"duration must be positive, got {duration}.")
        self.body, self.duration = env.push_targets[point], duration
        self.physics_dt, self.control_dt = env.physics_dt, env.control_dt
        self._zero_wrench = env.zero_wrench
        self.register_buffer("begin", env.physics_dt * torch.arange(env.substeps))
        self.register_buffer("start", torch.full((env.num_envs,), torch.inf))  # [s from now]
        self.register_buffer("force", torch.zeros(env.num_envs, 3))  # of the push [N]

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        wrench = tensordict.get(("push", "wrench"), None)
        if wrench is None:
            wrench = self._zero_wrench()
        share = force_share(self.begin, self.physics_dt, self.start, self.duration)
        wrench[:, :, self.body, :3] += share[..., None] * self.force[:, None]
        tensordict["push", "force"] = share.mean(1, keepdim=True) * self.force
        tensordict["push", "wrench"] = wrench
        self.start = self.start - self.control_dt
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        next_tensordict["push", "force"] = tensordict["push", "force"]
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        tensordict_reset["push", "force"] = torch.zeros_like(self.force)
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["push", "force"] = Unbounded(self.force.shape)
        return observation_spec


class RandomPush(_Push):
    """Pushes every world at random times, with a horizontal force of random size and heading.

    The first and last physics steps of a push carry a share of its force, so that force x time is
    the impulse at any control and physics rate. Size and heading are uniform.

    Keys: adds to ``("push", "wrench")`` ``(N, S, bodies, 6)`` [N, N m; world]; writes
    ``("push", "force")`` ``(N, 3)``, the mean force over the step just taken [N; world].

    Args:
        env: the base env.
        point: where it acts: a push point or a link, see ``HumanoidEnv.push_targets``.
        duration: length of a push [s].
        interval: shortest and longest rest before a push [s], the first one included. A rest may
            grow to the end of the control step in which the push before it ended.
        force: smallest and largest force [N]; or
        impulse: smallest and largest impulse [N s]; or
        size: smallest and largest dimensionless impulse, ``impulse / (m sqrt(g h0))``.

    Raises:
        ValueError: on an unknown point, a bad range, or not just one of the three sizes.
    """

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        point: str,
        duration: float,
        interval: tuple[float, float],
        force: tuple[float, float] | None = None,
        impulse: tuple[float, float] | None = None,
        size: tuple[float, float] | None = None,
    ):
        super().__init__(env, point, duration)
        ranges = {"force": force, "impulse": impulse, "size": size}
        given = {name: value for name, value in ranges.items() if value is not None}
        if len(given) != 1:
            raise ValueError(
                f"give just one of force, impulse and size, got {', '.join(given) or 'none'}."
            )
        for name, (low, high) in {**given, "interval": interval}.items():
            if not 0 <= low <= high:
                raise ValueError(f"{name} must be [smallest, largest], got {[low, high]}.")
        unit = {"force": 1.0, "impulse": 1 / duration, "size": env.robot.impulse_unit / duration}
        ((name, value),) = given.items()
        self.strength = tuple(bound * unit[name] for bound in value)  # [N]
        self.interval, self.rng = interval, env.rng

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        tensordict = super()._inv_call(tensordict)
        over = self.start + self.duration
        self._draw(rows=over <= 0, rest_from=over.clamp_max(0.0))
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        self._draw(rows=reset_rows(tensordict), rest_from=torch.zeros_like(self.start))
        return super()._reset(tensordict, tensordict_reset)

    def _draw(self, rows: Tensor, rest_from: Tensor) -> None:
        """Plans the next push of the worlds in ``rows``, resting since ``rest_from`` [s]."""
        wait, strength, turn = torch.rand(3, len(rows), generator=self.rng)
        wait = self.interval[0] + (self.interval[1] - self.interval[0]) * wait
        strength = self.strength[0] + (self.strength[1] - self.strength[0]) * strength
        heading = 2 * math.pi * turn
        force = torch.stack([heading.cos(), heading.sin(), torch.zeros_like(turn)], -1)
        self.start = torch.where(rows, (rest_from + wait).clamp_min(0.0), self.start)
        self.force = torch.where(rows[:, None], strength[:, None] * force, self.force)


class ScriptedPush(_Push):
    """Pushes each world once an episode, at a time and with a force given beforehand.

    Keys: as ``RandomPush``.

    Args:
        env: the base env.
        point: where it acts: a push point or a link, see ``HumanoidEnv.push_targets``.
        duration: length of the push [s].
        time: when it begins ``(N,)`` [s since the episode began].
        plan: its force ``(N, 3)`` [N; world]. Both may be changed between episodes.
    """

    def __init__(
        self, env: HumanoidEnv, *, point: str, duration: float, time: Tensor, plan: Tensor
    ):
        super().__init__(env, point, duration)
        self.register_buffer("time", time)
        self.register_buffer("plan", plan)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict)
        self.start = torch.where(rows, self.time, self.start)
        self.force = torch.where(rows[:, None], self.plan, self.force)
        return super()._reset(tensordict, tensordict_reset)
