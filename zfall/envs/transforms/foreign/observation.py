"""The observation of a policy of another framework, with its history."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NotRequired, TypedDict

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.foreign.joints import places, reference_pose
from zfall.envs.transforms.foreign.seen import MOST_ACTIONS, Seen, Term
from zfall.envs.transforms.values import reset_rows
from zfall.errors import named
from zfall.simulation.model import base_center_of_mass
from zfall.values import Bounds, Count, Name, Names


class Entry(TypedDict):
    """A term, and what is done to its numbers: first the clip, then the scale."""

    of: Any
    scale: NotRequired[float | Sequence[float]]
    clip: NotRequired[Bounds | None]
    history: NotRequired[Count]


class ForeignObservation(Transform):
    """Terms in one vector, clipped, scaled and stacked as another framework does it.

    Each term is made, clipped, scaled, and then kept for its history. ``stack: terms`` lines up
    the history of the first term, then that of the second; ``stack: frames`` lines up all terms of
    one step, then all of the next.

    Keys: reads what its terms read, as measured where it is, and ``action`` ``(N, A)``; writes
    ``out_key`` ``(N, D)``.

    Args:
        env: the base env.
        joints: names of the policy's joints, in its order.
        terms: in their order, each a table: ``of`` with a ``_target_``, ``scale`` (a number, or one
            for each of its numbers), ``clip`` and ``history``, its own number of steps in place of
            ``history``.
        reference: angles by joint that positions start from [rad]; of all others those of the
            robot's stand.
        history: control steps that the vector holds, this one included.
        stack: ``terms`` or ``frames``.
        oldest: whether the oldest step stands ``first`` or ``last``.
        start: what stands for the steps before the first: ``repeat`` it, or ``zeros``.
        clip: of the whole vector, after the scales.
        out_key: name of the vector.

    Raises:
        ValueError: on a joint that the robot lacks, a quantity that is not there, scales of another
            number, or frames with terms of different histories.

    Source: Isaac Lab 2.3.2 and mjlab 1.6.0 clip, scale and then keep each term by itself, the
    oldest first; after a reset all of a history is the first value (``ObservationManager``,
    ``CircularBuffer``). Playground 0.2.0 rolls whole frames into zeros, the newest first
    (``obs_history`` of its hands). Tasks after ``legged_gym`` stack whole frames, the oldest first,
    and clip the vector after the scales.
    """

    measured = True

    steps: Tensor
    actions: Tensor
    index: Tensor
    reference: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        joints: Names,
        terms: Sequence[Entry],
        reference: Mapping[str, float] | None = None,
        history: Count = 1,
        stack: Literal["terms", "frames"] = "terms",
        oldest: Literal["first", "last"] = "first",
        start: Literal["repeat", "zeros"] = "repeat",
        clip: Bounds | None = None,
        out_key: Name = "observation",
    ):
        self.terms: list[Term] = [entry["of"] for entry in terms]
        if not self.terms:
            raise ValueError("terms must name at least one term, got none.")
        reads = list(dict.fromkeys(key for term in self.terms for key in term.reads))
        super().__init__(in_keys=reads, out_keys=[out_key])
        needs_env(self, env, "what was seen in the steps before")
        self.robot, self.control_dt = env.robot, env.control_dt
        self.lengths = [entry.get("history", history) for entry in terms]
        if stack == "frames" and len({*self.lengths}) > 1:
            raise ValueError(f"stack must be terms where their histories differ, {self.lengths}.")
        self.stack, self.oldest, self.start = stack, oldest, start
        self.bounds = [_bounds(entry.get("clip")) for entry in terms]
        self.whole = _bounds(clip)
        self.scales = [torch.as_tensor(entry.get("scale", 1.0)).float() for entry in terms]
        self.base_com = base_center_of_mass(env.simulation.model)
        self.register_buffer("index", places(env.robot, joints))
        self.register_buffer("reference", reference_pose(env, reference or {}))
        self.register_buffer("steps", torch.zeros(env.num_envs, 1, dtype=torch.long))
        self.register_buffer("actions", torch.zeros(env.num_envs, MOST_ACTIONS, len(joints)))
        for number in range(len(terms)):  # of full size once the sizes of the terms are known
            self.register_buffer(f"kept_{number}", torch.zeros(env.num_envs, 0, 0))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self.steps = self.steps + 1
        self.actions = torch.cat([tensordict["action"][:, None], self.actions[:, :-1]], 1)
        for number, value in enumerate(self._values(next_tensordict)):
            kept = getattr(self, f"kept_{number}")
            setattr(self, f"kept_{number}", torch.cat([kept[:, 1:], value[:, None]], 1))
        return next_tensordict.set(self.out_keys[0], self._vector())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.steps = torch.where(rows[:, None], 0, self.steps)
        self.actions = torch.where(rows[:, None, None], 0.0, self.actions)
        for number, value in enumerate(self._values(tensordict_reset)):
            kept = getattr(self, f"kept_{number}")
            begin = value[:, None].expand_as(kept).clone()
            if self.start == "zeros":
                begin[:, :-1] = 0.0
            setattr(self, f"kept_{number}", torch.where(rows[:, None, None], begin, kept))
        return tensordict_reset.set(self.out_keys[0], self._vector())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for key in self.in_keys:
            if key not in observation_spec.keys(True):
                there = ", ".join(map(str, observation_spec.keys(True, True)))
                raise ValueError(f"terms must read what is there ({there}), got {key}.")
        zero = self._seen(observation_spec.zero())
        for number, (term, scale) in enumerate(zip(self.terms, self.scales, strict=True)):
            with named(f"terms.{number}"):
                value = term(zero)
                if scale.dim() and len(scale) != value.shape[1]:
                    raise ValueError(
                        f"scale must be a number, or one for each of the term's {value.shape[1]} "
                        f"numbers, got {len(scale)}."
                    )
            shape = (len(value), self.lengths[number], value.shape[1])
            if getattr(self, f"kept_{number}").shape != shape:  # only now known
                setattr(self, f"kept_{number}", torch.zeros(shape))
        observation_spec[self.out_keys[0]] = Unbounded(self._vector().shape)
        return observation_spec

    def sizes(self) -> dict[str, int]:
        """How many numbers of the vector each term gives, by its class and place."""
        kept = [getattr(self, f"kept_{number}") for number in range(len(self.terms))]
        names = (f"{type(term).__name__} {n}" for n, term in enumerate(self.terms))
        return dict(zip(names, (each[0].numel() for each in kept), strict=True))

    def _values(self, tensordict: TensorDictBase) -> list[Tensor]:
        """Each term of this step ``(N, size)``, clipped and scaled."""
        seen = self._seen(tensordict)
        values = zip(self.terms, self.bounds, self.scales, strict=True)
        return [term(seen).clamp(*bounds) * scale for term, bounds, scale in values]

    def _seen(self, tensordict: TensorDictBase) -> Seen:
        fixed = (self.robot, self.index, self.reference, self.base_com)
        return Seen(tensordict, *fixed, self.steps, self.control_dt, self.actions)

    def _vector(self) -> Tensor:
        kept = [getattr(self, f"kept_{number}") for number in range(len(self.terms))]
        ordered = kept if self.oldest == "first" else [each.flip(1) for each in kept]
        join: Callable[[list[Tensor]], Tensor] = _JOINED[self.stack]
        return join(ordered).clamp(*self.whole)


def _by_term(kept: list[Tensor]) -> Tensor:
    return torch.cat([each.flatten(1) for each in kept], -1)


def _by_frame(kept: list[Tensor]) -> Tensor:
    return torch.cat(kept, -1).flatten(1)


_JOINED = {"terms": _by_term, "frames": _by_frame}


def _bounds(clip: Sequence[float] | None) -> tuple[float, float]:
    low, high = (-math.inf, math.inf) if clip is None else clip
    return float(low), float(high)
