"""The mode machine: recover, kneel, stable."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms.falls import body_contact
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.values import reset_rows
from zfall.falling.terms import resting_kneel
from zfall.rotations import tilt
from zfall.values import Fraction, NotNegativeOrInfinite, Positive, PositiveOrInfinite, one_of

MODES = ("recover", "kneel", "stable")
RECOVER, KNEEL, STABLE = range(3)


class ModeState(NamedTuple):
    """The state of a machine, integer tensors of one shape.

    Attributes:
        mode: ``RECOVER``, ``KNEEL`` or ``STABLE``.
        ahead: steps in a row for which the condition of the next mode has been true.
        back: likewise for the condition that leads back to RECOVER.
    """

    mode: Tensor
    ahead: Tensor
    back: Tensor


@dataclass(frozen=True, kw_only=True)
class ModeRule:
    """RECOVER -> KNEEL -> STABLE, each after a condition was true for some steps in a row.

    Args:
        hold: steps in danger from RECOVER to KNEEL.
        rest: steps at rest on a knee from KNEEL to STABLE.
        back: steps of standing from either back to RECOVER; ``None``: there is no way back.

    Raises:
        ValueError: if one of them is not at least 1.
    """

    hold: int
    rest: int
    back: int | None = None

    def __post_init__(self) -> None:
        for name in ("hold", "rest", "back"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name} must be at least one step, got {value}.")

    def start(self, like: Tensor, mode: int = RECOVER) -> ModeState:
        """The state at the beginning, of the shape of ``like``."""
        zero = torch.zeros_like(like, dtype=torch.long)
        return ModeState(zero + mode, zero, zero)

    def advance(
        self, state: ModeState, danger: Tensor, resting: Tensor, standing: Tensor
    ) -> ModeState:
        """The state after a step with these conditions, bool tensors of the state's shape."""
        mode, ahead, back = state
        condition = torch.where(mode == RECOVER, danger, resting & (mode == KNEEL))
        ahead = torch.where(condition, ahead + 1, 0)
        go = ahead >= torch.where(mode == RECOVER, self.hold, self.rest)
        back = torch.where(standing & (mode != RECOVER), back + 1, 0)
        rise = torch.zeros_like(go) if self.back is None else (back >= self.back) & ~go
        mode = torch.where(rise, RECOVER, mode + go.long())
        changed = go | rise
        return ModeState(mode, torch.where(changed, 0, ahead), torch.where(changed, 0, back))


def in_danger(lean: Tensor, rate: Tensor, *, angle: float, angular_velocity: float) -> Tensor:
    """Whether the trunk leans [rad] or turns [rad/s] by more than the bounds, bool."""
    return (lean > angle) | (rate > angular_velocity)


def modes_over(rule: ModeRule, danger: Tensor, resting: Tensor, standing: Tensor) -> Tensor:
    """Modes ``(T, ...)`` along a history of conditions ``(T, ...)``, from RECOVER on."""
    state, modes = rule.start(danger[0]), []
    for step in zip(danger, resting, standing, strict=True):
        state = rule.advance(state, *step)
        modes.append(state.mode)
    return torch.stack(modes)


class ModeMachine(Transform):
    """Goes from RECOVER to KNEEL when a fall is near, and to STABLE when the robot rests.

    Danger is a tilt above ``angle`` or an angular velocity above ``angular_velocity``. With
    ``probability`` it is a predicted fall instead; this needs a ``FallPredictor`` earlier in the
    table. Rest is ``resting_kneel``. The joints of an exploring policy never rest: training needs
    wide bounds, and ``StableHold`` then stops the joints. The way back to RECOVER is standing: no
    danger of either kind, and no contact but the feet's.

    Keys: reads ``base_orientation``, ``base_angular_velocity`` [rad/s], ``contact_force_peak``
    [N], what ``resting_kneel`` reads, and ``fall_probability`` ``(N, 1)`` if there is a
    ``probability``; writes ``mode`` ``(N, 3)``, one-hot: recover, kneel, stable.

    Args:
        env: the base env.
        angle: [rad].
        angular_velocity: of the base, its norm [rad/s].
        hold: time for which danger must last [s]. This and the other times are rounded to
            control steps, at least one, halves to the even number: 0.5 s at 25 Hz are 12.
        rest: time of rest that makes a kneel stable [s].
        rest_speed: of the base at rest, at most [m/s and rad/s].
        rest_joint_speed: of every joint at rest, at most [rad/s].
        back: time of standing after which it recovers again [s]; ``None``: there is no way back.
        probability: bound of ``fall_probability`` that replaces the two above; ``None``: they
            count.
        initial: mode at the beginning of an episode.

    Raises:
        ValueError: on a bound or time that is not positive, or an unknown mode.

    Source: report of the Zeroth-01 project, its mode machine (0.5 rad, 10 frames at 50 Hz), and
    its design notes (2 rad/s).
    """

    mirror_signs: ClassVar[Mapping[str, tuple[float, ...]]] = {"mode": (1.0, 1.0, 1.0)}
    units: ClassVar[Mapping[str, str]] = {"mode": "0 or 1: recover, kneel, stable"}

    ahead: Tensor
    behind: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        angle: NotNegativeOrInfinite = 0.5,
        angular_velocity: NotNegativeOrInfinite = 2.0,
        hold: Positive = 0.2,
        rest: Positive = 0.5,
        rest_speed: PositiveOrInfinite = 0.1,
        rest_joint_speed: PositiveOrInfinite = 0.1,
        back: Positive | None = None,
        probability: Fraction | None = None,
        initial: Annotated[str, one_of(*MODES)] = "recover",
    ):
        super().__init__(in_keys=["base_orientation"], out_keys=["mode"])
        needs_env(self, env, "a memory of each world")
        if initial not in MODES:
            raise ValueError(f"initial must be one of {', '.join(MODES)}, got {initial!r}.")
        if probability is not None and not 0 < probability < 1:
            raise ValueError(f"probability must lie in (0, 1), got {probability}.")
        times = {"hold": hold, "rest": rest} | ({} if back is None else {"back": back})
        bounds = {"angle": angle, "angular_velocity": angular_velocity}
        rests = {"rest_speed": rest_speed, "rest_joint_speed": rest_joint_speed}
        for name, value in (bounds | times | rests).items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}.")
        steps = {name: max(1, round(time / env.control_dt)) for name, time in times.items()}
        self.rule = ModeRule(**steps)
        self.bounds, self.probability = bounds, probability
        self._resting = partial(
            resting_kneel, robot=env.robot, speed=rest_speed, joint_speed=rest_joint_speed
        )
        self.initial = MODES.index(initial)
        for name in ("ahead", "behind"):
            self.register_buffer(name, torch.zeros(env.num_envs, dtype=torch.long))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        state = ModeState(tensordict["mode"].argmax(-1), self.ahead, self.behind)
        lean = tilt(next_tensordict["base_orientation"])
        rate = next_tensordict["base_angular_velocity"].norm(dim=-1)
        danger = in_danger(lean, rate, **self.bounds)
        calm = ~danger & ~body_contact(tensordict, next_tensordict).squeeze(-1)
        if self.probability is not None:
            danger = next_tensordict["fall_probability"].squeeze(-1) > self.probability
            calm &= ~danger
        resting = self._resting(tensordict, next_tensordict).squeeze(-1)
        mode, self.ahead, self.behind = self.rule.advance(state, danger, resting, calm)
        return next_tensordict.set("mode", one_hot(mode))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.ahead = torch.where(rows, 0, self.ahead)
        self.behind = torch.where(rows, 0, self.behind)
        mode = torch.full((len(rows),), self.initial)
        return tensordict_reset.set("mode", one_hot(mode))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        if self.probability is not None and "fall_probability" not in observation_spec.keys():
            raise ValueError(
                "probability must be null without a FallPredictor earlier in the table, "
                f"got {self.probability}."
            )
        observation_spec["mode"] = Unbounded((*observation_spec.shape, len(MODES)))
        return observation_spec


def one_hot(mode: Tensor) -> Tensor:
    """Modes ``(N,)`` as rows ``(N, 3)``, float32."""
    return torch.nn.functional.one_hot(mode, len(MODES)).float()
