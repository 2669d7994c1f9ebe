"""When to recover, when to kneel, and when it is done."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms.falls import body_contact
from zfall.envs.transforms.observations.measured import read_measured
from zfall.envs.transforms.values import reset_rows
from zfall.falling.terms import resting_kneel
from zfall.rotations import tilt

MODES = ("recover", "kneel", "stable")
RECOVER, KNEEL, STABLE = range(3)


class ModeState(NamedTuple):
    """Where a machine stands, in tensors of one shape: integers, of no unit.

    ``ahead``: steps in a row for which what leads to the next mode has held; ``back``: likewise
    for what leads back to RECOVER.
    """

    mode: Tensor
    ahead: Tensor
    back: Tensor


@dataclass(frozen=True, kw_only=True)
class ModeRule:
    """RECOVER -> KNEEL -> STABLE, each after a condition has held for some steps in a row.

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
        """The state after a step in which these conditions, bool, held or did not."""
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
    """Modes along a history ``(T, ...)``, as a robot would go through them one step at a time."""
    state, modes = rule.start(danger[0]), []
    for step in zip(danger, resting, standing, strict=True):
        state = rule.advance(state, *step)
        modes.append(state.mode)
    return torch.stack(modes)


class ModeMachine(Transform):
    """Goes from RECOVER to KNEEL when a fall is near, and to STABLE when the robot rests.

    Danger is a tilt above ``angle`` or an angular velocity above ``angular_velocity`` or, with a
    ``FallPredictor`` before it and a ``probability``, a predicted fall. Rest is ``resting_kneel``;
    a policy that explores never has its joints at rest, so that training needs wide bounds, and
    ``StableHold`` then stops them. Standing, the way back, is no danger of either kind and no
    contact but the feet's.

    Keys: reads what these do, writes ``mode`` ``(N, 3)``, one of them 1: recover, kneel, stable.

    Args:
        env: the base env.
        angle: [rad].
        angular_velocity: of the base, its norm [rad/s].
        hold: time for which danger must last [s]; at least one step. This and the other times are
            rounded to control steps, halves to the even number: 0.5 s at 25 Hz are 12.
        rest: time of rest that makes a kneel stable [s].
        rest_speed: of the base at rest, at most [m/s and rad/s].
        rest_joint_speed: of every joint at rest, at most [rad/s].
        back: time of standing after which it recovers again [s], or no way back.
        probability: of ``fall_probability`` above which there is danger, instead of the bounds.
        initial: mode at the beginning of an episode.

    Raises:
        ValueError: on a bound or time that is not positive, or an unknown mode.

    Source: report of the Zeroth-01 project, its mode machine (0.5 rad, 10 frames at 50 Hz), and
    its design notes (2 rad/s).
    """

    ahead: Tensor
    behind: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        angle: float = 0.5,
        angular_velocity: float = 2.0,
        hold: float = 0.2,
        rest: float = 0.5,
        rest_speed: float = 0.1,
        rest_joint_speed: float = 0.1,
        back: float | None = None,
        probability: float | None = None,
        initial: str = "recover",
    ):
        super().__init__(in_keys=["base_orientation"], out_keys=["mode"])
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
        rows = reset_rows(tensordict)
        self.ahead = torch.where(rows, 0, self.ahead)
        self.behind = torch.where(rows, 0, self.behind)
        mode = torch.full((len(rows),), self.initial)
        return tensordict_reset.set("mode", one_hot(mode))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        if self.probability is not None and "fall_probability" not in observation_spec.keys():
            raise ValueError(
                "probability must be null without a FallPredictor before the mode machine, "
                f"got {self.probability}."
            )
        observation_spec["mode"] = Unbounded((*observation_spec.shape, len(MODES)))
        return observation_spec


def one_hot(mode: Tensor) -> Tensor:
    """Modes ``(N,)`` as rows ``(N, 3)``, float32."""
    return torch.nn.functional.one_hot(mode, len(MODES)).float()


class StableHold(Transform):
    """Holds the last target of the servos in mode STABLE, whatever the policy asks for.

    Keys: reads ``mode``, changes ``target`` ``(N, J)`` [rad], and ``control`` ``(N, S, J)`` [rad]
    where there is one: targets that move stop; comes after what makes them.

    Args:
        env: the base env.
    """

    held: Tensor

    def __init__(self, env: HumanoidEnv):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["target"])
        self.register_buffer("held", env.stand_position.repeat(env.num_envs, 1))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        mode = tensordict.get("mode", None)
        if mode is None:
            raise ValueError("StableHold needs the key mode: put a ModeMachine into the table.")
        stable = mode[:, STABLE, None] > 0
        self.held = torch.where(stable, self.held, tensordict["target"])
        control = tensordict.get("control", None)
        if control is not None:
            control = torch.where(stable[:, None], self.held[:, None], control)
            tensordict["control"] = control
        return tensordict.set("target", self.held.clone())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict)[:, None]
        self.held = torch.where(rows, tensordict_reset["joint_position"], self.held)
        return tensordict_reset


class FallPredictor(Transform):
    """Says after every step how likely a fall can no longer be avoided.

    Keys: reads ``keys``, as measured where sensing comes before it in the table, and writes
    ``fall_probability`` ``(N, 1)``; its memory begins anew with every episode.

    Args:
        env: the base env.
        network: a module with ``hidden_size`` that takes measurements ``(N, D)`` and a memory
            ``(N, H)`` and returns a probability ``(N, 1)`` and the next memory.
        keys: what it was trained with, in order.

    Raises:
        ValueError: if the network was trained with other quantities or at another rate.
    """

    memory: Tensor
    measured = True  # sensing must come before it

    def __init__(self, env: HumanoidEnv, *, network: Any, keys: Sequence[str]):
        super().__init__(in_keys=list(keys), out_keys=["fall_probability"])
        known = getattr(network, "trained_with", None)
        for name, value in (("keys", list(keys)), ("control_dt", env.control_dt)):
            if known is not None and value != known[name]:
                raise ValueError(
                    f"{name} must be what the network was trained with, {known[name]}, got {value}."
                )
        self.network = network
        self.register_buffer("memory", torch.zeros(env.num_envs, network.hidden_size))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        values = [read_measured(next_tensordict, key).flatten(1) for key in self.in_keys]
        measured, size = torch.cat(values, -1), len(self.network.normalizer.mean)
        if measured.shape[1] != size:
            raise ValueError(
                f"keys must be what the network was trained with, {size} numbers, got "
                f"{measured.shape[1]}."
            )
        with torch.no_grad():
            probability, self.memory = self.network(measured, self.memory)
        return next_tensordict.set("fall_probability", probability)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict)
        self.memory = torch.where(rows[:, None], 0.0, self.memory)
        return tensordict_reset.set("fall_probability", torch.zeros(len(rows), 1))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["fall_probability"] = Unbounded((*observation_spec.shape, 1))
        return observation_spec
