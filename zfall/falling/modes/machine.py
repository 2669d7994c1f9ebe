"""The mode machine: recover, kneel, stable and, where the table says so, rise."""

import math
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
from zfall.falling.terms import lying_still, resting_kneel
from zfall.rotations import tilt
from zfall.values import Fraction, NotNegativeOrInfinite, Positive, PositiveOrInfinite, one_of

MODES = ("recover", "kneel", "stable", "rise")
SHOWN = 1.25  # size I of a push that shows what follows a fall
RECOVER, KNEEL, STABLE, RISE = range(4)


class ModeState(NamedTuple):
    """The state of a machine, integer tensors of one shape.

    Attributes:
        mode: ``RECOVER``, ``KNEEL``, ``STABLE`` or ``RISE``.
        ahead: steps in a row for which the condition of the next mode has been true.
        back: likewise for the condition that leads back to RECOVER.
    """

    mode: Tensor
    ahead: Tensor
    back: Tensor


@dataclass(frozen=True, kw_only=True)
class ModeRule:
    """RECOVER -> KNEEL -> STABLE -> RISE, each after a condition was true for some steps in a row.

    Args:
        hold: steps in danger from RECOVER to KNEEL.
        rest: steps at rest from KNEEL to STABLE.
        back: steps of standing from any back to RECOVER; ``None``: there is no way back.
        rise: steps at rest from STABLE to RISE; ``None``: it never rises.

    Raises:
        ValueError: if one of them is not at least 1.
    """

    hold: int
    rest: int
    back: int | None = None
    rise: int | None = None

    def __post_init__(self) -> None:
        for name in ("hold", "rest", "back", "rise"):
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
        rests = mode == KNEEL if self.rise is None else (mode == KNEEL) | (mode == STABLE)
        condition = torch.where(mode == RECOVER, danger, resting & rests)
        ahead = torch.where(condition, ahead + 1, 0)
        steps = mode.new_tensor([self.hold, self.rest, self.rise or 1, 1])
        go = condition & (ahead >= steps[mode])
        back = torch.where(standing & (mode != RECOVER), back + 1, 0)
        stands = torch.zeros_like(go) if self.back is None else (back >= self.back) & ~go
        mode = torch.where(stands, RECOVER, mode + go.long())
        changed = go | stands
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
    """Goes from RECOVER to KNEEL when a fall is near, to STABLE at rest, and to RISE to get up.

    Danger is a tilt above ``angle`` or an angular velocity above ``angular_velocity``. With
    ``probability`` it is a predicted fall instead; this needs a ``FallPredictor`` earlier in the
    table. With ``lost`` so large a tilt is danger, too, whatever was predicted. Rest is
    ``resting_kneel``. The joints of an exploring policy never rest: training needs wide bounds,
    and ``StableHold`` then stops the joints. The way back to RECOVER is standing: no danger of
    either kind, and no contact but the feet's.

    With ``rise`` there is a fourth mode, in which a ``RiseReference`` gets the robot up. Rest is
    then any posture in which the robot moves as little as in a ``resting_kneel``, lying as well.

    Keys: reads ``base_orientation``, ``base_angular_velocity`` [rad/s], ``contact_force_peak``
    [N], what ``resting_kneel`` reads, and ``fall_probability`` ``(N, 1)`` if there is a
    ``probability``; writes ``mode`` ``(N, 3)``, one-hot: recover, kneel, stable; with ``rise``
    ``(N, 4)``, the last one rise.

    Args:
        env: the base env.
        angle: [rad].
        angular_velocity: of the base, its norm [rad/s].
        hold: time for which danger must last [s]. This and the other times are rounded to
            control steps, at least one, halves to the even number: 0.5 s at 25 Hz are 12.
        rest: time of rest from KNEEL to STABLE [s].
        rest_speed: of the base at rest, at most [m/s and rad/s].
        rest_joint_speed: of every joint at rest, at most [rad/s].
        back: time of standing after which it recovers again [s]; ``None``: there is no way back.
        rise: time of rest in STABLE after which it gets up [s]; needs ``back``; ``None``: never.
        probability: bound of ``fall_probability`` that replaces the two above; ``None``: they
            count.
        lost: tilt that nobody comes back from [rad]; ``None``: a fall that is not predicted stays
            in RECOVER.
        initial: mode at the beginning of an episode.

    Raises:
        ValueError: on a bound or time that is not positive, an unknown mode, or ``rise`` without
            ``back``.

    Source: report of the Zeroth-01 project, its mode machine (0.5 rad, 10 frames at 50 Hz), and
    its design notes (2 rad/s).
    """

    units: ClassVar[Mapping[str, str]] = {"mode": "0 or 1: recover, kneel, stable, perhaps rise"}
    mode_names: ClassVar[tuple[str, ...]] = MODES

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
        rise: Positive | None = None,
        probability: Fraction | None = None,
        lost: Positive | None = None,
        initial: Annotated[str, one_of(*MODES)] = "recover",
    ):
        super().__init__(in_keys=["base_orientation"], out_keys=["mode"])
        needs_env(self, env, "a memory of each world")
        self.modes = MODES if rise is not None else MODES[:RISE]
        if initial not in self.modes:
            raise ValueError(f"initial must be one of {', '.join(self.modes)}, got {initial!r}.")
        if rise is not None and back is None:
            raise ValueError("back must be a time where there is rise, got null.")
        if probability is not None and not 0 < probability < 1:
            raise ValueError(f"probability must lie in (0, 1), got {probability}.")
        given = {"hold": hold, "rest": rest, "back": back, "rise": rise}
        times = {name: time for name, time in given.items() if time is not None}
        bounds = {"angle": angle, "angular_velocity": angular_velocity}
        rests = {"rest_speed": rest_speed, "rest_joint_speed": rest_joint_speed}
        tilts = {} if lost is None else {"lost": lost}
        for name, value in (bounds | times | rests | tilts).items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}.")
        steps = {name: max(1, round(time / env.control_dt)) for name, time in times.items()}
        self.rule = ModeRule(**steps)
        self.bounds, self.probability = bounds, probability
        if lost is not None and probability is None:
            bounds["angle"] = min(angle, lost)
        self.lost = math.inf if lost is None else lost
        self._resting = partial(
            resting_kneel, robot=env.robot, speed=rest_speed, joint_speed=rest_joint_speed
        )
        self._still = partial(lying_still, speed=rest_speed, joint_speed=rest_joint_speed)
        self.mirror_signs = {"mode": (1.0,) * len(self.modes)}
        self.initial = MODES.index(initial)
        # [I, s]: once if it stays where it lies, else with time to get up.
        self.played_with = (SHOWN, 60.0 if rise is None else 10.0)
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
            danger |= lean > self.lost
            calm &= ~danger
        resting = self._resting(tensordict, next_tensordict).squeeze(-1)
        if self.rule.rise is not None:
            resting |= self._still(tensordict, next_tensordict).squeeze(-1)
        mode, self.ahead, self.behind = self.rule.advance(state, danger, resting, calm)
        return next_tensordict.set("mode", one_hot(mode, len(self.modes)))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.ahead = torch.where(rows, 0, self.ahead)
        self.behind = torch.where(rows, 0, self.behind)
        mode = torch.full((len(rows),), self.initial)
        return tensordict_reset.set("mode", one_hot(mode, len(self.modes)))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        if self.probability is not None and "fall_probability" not in observation_spec.keys():
            raise ValueError(
                "probability must be null without a FallPredictor earlier in the table, "
                f"got {self.probability}."
            )
        observation_spec["mode"] = Unbounded((*observation_spec.shape, len(self.modes)))
        return observation_spec


def one_hot(mode: Tensor, modes: int = RISE) -> Tensor:
    """Modes ``(N,)`` as rows ``(N, modes)``, float32; the three first ones by themselves."""
    return torch.nn.functional.one_hot(mode, modes).float()
