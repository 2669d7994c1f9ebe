"""Pushes given beforehand."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.pushes.force import PushForces
from zfall.envs.transforms.values import reset_rows


class ScriptedPush(Transform):
    """Pushes each world at times and with forces given beforehand, also several at once.

    Keys: as ``RandomPush``.

    Args:
        env: the base env.
        point: where they act: a push point or a link, or one for each of E pushes.
        duration: length of the pushes [s], or of each.
        time: when they begin [s since the episode began]: one for all, ``(E,)``, ``(N,)`` if E is
            1, or ``(N, E)``.
        plan: their peak forces [N; world]: ``(3,)``, a list of E vectors, a tensor ``(N, 3)`` of
            one push for each world, or one ``(N, E, 3)``. The buffers ``time`` and ``plan`` of
            full shape may be changed between episodes.
        profile: see ``RandomPush``.

    Raises:
        ValueError: on an unknown point or profile, a duration that is not positive, or shapes
            that do not fit.
    """

    start: Tensor
    time: Tensor
    plan: Tensor
    duration: Tensor
    index: Tensor

    replaced_in_batteries = True  # by pushes of a battery

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        point: str | Sequence[str],
        duration: float | Sequence[float],
        time: float | Sequence[float] | Tensor,
        plan: Sequence[float] | Sequence[Sequence[float]] | Tensor,
        profile: str = "rectangular",
    ):
        super().__init__(in_keys_inv=[("push", "wrench")], out_keys_inv=[("push", "wrench")])
        needs_env(self, env, "physics to act on")
        num = env.num_envs
        forces = torch.as_tensor(plan, dtype=torch.float32)
        if forces.dim() == 2 and isinstance(plan, Tensor):  # (N, 3), one push each
            forces = forces[:, None]
        forces = forces.reshape(-1, 1, 3) if forces.dim() == 1 else forces
        events = forces.shape[-2]
        names = [point] if isinstance(point, str) else list(point)
        points = list(dict.fromkeys(names))
        self.forces = PushForces(env, points, profile)
        times = torch.as_tensor(time, dtype=torch.float64)
        times = times[:, None] if events == 1 and times.dim() == 1 else times
        lengths = torch.as_tensor(duration, dtype=torch.float64)
        if not (lengths > 0).all():
            raise ValueError(f"duration must be positive, got {duration}.")
        index = torch.tensor([points.index(name) for name in names])
        shapes = {"time": times, "plan": forces[..., 0], "duration": lengths, "point": index}
        for name, value in shapes.items():
            pairs = zip(reversed(value.shape), (events, num), strict=False)
            if value.dim() > 2 or any(size not in (1, full) for size, full in pairs):
                raise ValueError(
                    f"{name} must fit {num} worlds with {events} pushes, got shape "
                    f"{tuple(value.shape)}."
                )
        self.control_dt = env.control_dt
        self.register_buffer("time", times.expand(num, events).clone())
        self.register_buffer("plan", forces.expand(num, events, 3).clone())
        self.register_buffer("duration", lengths.expand(num, events).clone())
        self.register_buffer("index", index.expand(num, events).clone())
        never = torch.full((num, events), torch.inf, dtype=torch.float64)
        self.register_buffer("start", never)  # of each push [s from now]

    def begin(self, rows: Tensor, event: int, force: Tensor, duration: float) -> None:
        """Begins a push with the coming control step, whatever was planned.

        Args:
            rows: worlds that are pushed ``(N,)`` bool.
            event: which of the E pushes it takes the place of; it acts at that one's point.
            force: peak force ``(3,)`` [N; world].
            duration: [s].
        """
        self.plan[rows, event] = force.to(self.plan)
        self.duration[rows, event] = duration
        self.start[rows, event] = 0.0

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.forces.apply(
            base_env_of(self), tensordict, self.start, self.duration, self.plan, self.index
        )
        self.start = self.start - self.control_dt
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self.forces.observe(next_tensordict)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.start = torch.where(rows[:, None], self.time, self.start)
        self.forces.clear(tensordict_reset)
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        self.forces.specify(observation_spec)
        return observation_spec
