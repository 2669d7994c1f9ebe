"""Tasks that grow harder with success."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.simulation.parameters import ANY_NUMBER
from zfall.values import Fraction, NotNegative

_COUNTS = {"steps", "max_steps", "rule"}  # fields in whole steps, not of one world


class Curriculum(Transform):
    """Gives every world a level in [0, 1] that success raises, and moves other transforms by it.

    An episode that reaches its time limit raises the level of its world by ``up``, one that ends
    in a fall lowers it by ``down``; where the task is to reach something, its ``success`` raises
    it and everything else lowers it. Each field follows its world's level through its stages. In
    the table it comes after terminations and time limit.

    Keys: reads ``done`` and ``terminated``, or ``done`` and ``("terminations", success)``; writes
    ``curriculum_level`` ``(N, 1)``.

    Args:
        env: the base env.
        fields: ``transform.field: [first, ..., last]``: a number, or a pair of them, of a
            transform of the table, by the name it has there (``push.size``,
            ``noise.std.joint_position``), and its values at levels that are spread evenly over
            [0, 1]; in between they are interpolated.
        up: rise of the level after an episode without a fall.
        down: its loss after a fall.
        stepwise: whether to keep a stage's value until the next stage is reached.
        level: at the beginning.
        success: name of the condition of ``Terminations`` that is no failure but the aim.

    Raises:
        ValueError: on a field that does not exist or is no number, a stage beyond what its
            transform allows (``limits``), or a bad level.
    """

    level: Tensor
    lasting = ("level",)  # kept by worlds that are drawn anew

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        fields: Mapping[str, Sequence[Any]],
        up: NotNegative = 0.05,
        down: NotNegative = 0.05,
        stepwise: bool = False,
        level: Fraction = 0.0,
        success: str | None = None,
    ):
        super().__init__()
        needs_env(self, env, "the ends of episodes")
        if not 0.0 <= level <= 1.0:
            raise ValueError(f"level must lie in [0, 1], got {level}.")
        for name, value in (("up", up), ("down", down)):
            if value < 0:
                raise ValueError(f"{name} must not be negative, got {value}.")
        self.fields = {}
        for name, stages in fields.items():
            if not isinstance(stages, (list, tuple)) or len(stages) < 2:
                raise ValueError(f"fields.{name} must hold at least two stages, got {stages}.")
            try:
                rows = [list(s) if _pair(s) else s for s in stages]
                self.fields[name] = torch.tensor(rows, dtype=torch.float32)
            except (TypeError, ValueError) as error:
                raise ValueError(
                    f"fields.{name} must hold numbers or pairs alone, got {stages}."
                ) from error
        self.up, self.down, self.stepwise = up, down, stepwise
        self.success = success
        self._targets: dict[str, tuple[Any, str]] = {}
        self.register_buffer("level", torch.full((env.num_envs,), level))
        self.register_load_state_dict_post_hook(_move_fields)  # has a name: to be pickled

    def attach(self, transforms: Mapping[str, Transform]) -> None:
        """Finds the fields among the transforms of the table; called once by ``make_env``.

        Raises:
            ValueError: if one is not there or of another shape, or nothing ends in ``success``.
        """
        ends = [name for t in transforms.values() for name in getattr(t, "conditions", ())]
        if self.success is not None and self.success not in ends:
            raise ValueError(
                f"success must name a condition of terminations ({', '.join(ends)}), "
                f"got {self.success}."
            )
        for name, stages in self.fields.items():
            first, *middle, last = name.split(".")
            if first not in transforms or not (middle or last):
                raise ValueError(
                    f"fields.{name} must begin with a transform of the table, one of "
                    f"{', '.join(transforms)}."
                )
            owner: Any = transforms[first]
            for part in middle:
                owner = _read(owner, part, name)
            value = _read(owner, last, name)
            if _COUNTS & {*middle, last}:
                raise ValueError(f"fields.{name} must stay: it counts steps, of all worlds alike.")
            if last in getattr(owner, "not_movable", ()):
                raise ValueError(
                    f"fields.{name} must stay: the times between pushes follow from it."
                )
            if not (_number(value) or _pair(value)):
                raise ValueError(f"fields.{name} must be a number or a pair, it is {value!r}.")
            if _pair(value) != (stages.dim() == 2) or stages.shape[1:] not in ((), (2,)):
                raise ValueError(
                    f"fields.{name} must hold values like {value!r}, got {stages.tolist()}."
                )
            low, high = getattr(transforms[first], "limits", {}).get([*middle, last][0], ANY_NUMBER)
            sound = (stages >= low) & (stages <= high + 1e-6) & stages.isfinite()  # float32
            if not sound.all():
                raise ValueError(
                    f"fields.{name} must be finite and within [{low:g}, {high:g}] at every stage, "
                    f"got {stages.tolist()}."
                )
            self._targets[name] = (owner, last)
        self._move()

    def _move(self) -> None:
        """Sets every field to the values of the worlds' levels, ``(N,)`` or ``(2, N)``."""
        for name, (owner, field) in self._targets.items():
            stages = self.fields[name]
            place = self.level * (len(stages) - 1)
            low = (place + 1e-6).floor().clamp_max(len(stages) - 1)
            value = stages[low.long()].movedim(0, -1)
            if not self.stepwise:
                above = stages[(low.long() + 1).clamp_max(len(stages) - 1)]
                value = torch.lerp(value, above.movedim(0, -1), (place - low).clamp_min(0.0))
            if isinstance(owner, dict):
                owner[field] = value
            else:
                setattr(owner, field, value)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        done = next_tensordict["done"].squeeze(-1)
        if done.any():  # moved at once, so that the coming reset draws from the new level
            if self.success is None:
                good = ~next_tensordict["terminated"].squeeze(-1)
            else:
                good = next_tensordict["terminations", self.success].squeeze(-1)
            change = torch.where(good, torch.as_tensor(self.up), -torch.as_tensor(self.down))
            level = torch.where(done, (self.level + change).clamp(0.0, 1.0), self.level)
            if not torch.equal(level, self.level):
                self.level = level
                self._move()
        return next_tensordict.set("curriculum_level", self.level[:, None].clone())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        base_env_of(self)
        return tensordict_reset.set("curriculum_level", self.level[:, None].clone())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        observation_spec["curriculum_level"] = Unbounded((len(self.level), 1))
        return observation_spec


def _move_fields(module: Curriculum, incompatible: Any) -> None:
    module._move()


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _pair(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) == 2 and all(map(_number, value))


def _read(owner: Any, part: str, name: str) -> Any:
    """A field of a transform or an entry of a table within it."""
    there = owner if isinstance(owner, Mapping) else getattr(owner, "__dict__", {})
    if part not in there:
        known = ", ".join(key for key in there if not str(key).startswith("_"))
        raise ValueError(f"fields.{name}: there is no {part!r}, only {known or 'null'}.")
    return there[part]
