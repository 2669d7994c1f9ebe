"""The reward: a table of weighted terms."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms import bind
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.errors import in_one_line, named


class WeightedReward(Transform):
    """Sums reward terms, and keeps the share of each.

    Keys: writes ``reward`` ``(N, 1)``, the sum over terms of weight x value, and each summand
    under ``("reward_terms", name)`` ``(N, 1)``. What the terms read is said where they stand.

    Args:
        env: the base env; terms that ask for ``robot`` or ``joint_range`` are given its own.
        terms: ``name: [weight, term]``, a term being a function of the TensorDicts before and
            after the step that returns ``(N, 1)``. ``null`` in the place of the entry or of its
            weight leaves the term out.

    Raises:
        ValueError: if no term is left, an entry is none, or, at the first step, a term reads what
            is not there or returns another shape; and in any step, if one is not finite.
    """

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        terms: Mapping[str, tuple[float | None, Callable[..., Tensor] | None] | None],
    ):
        super().__init__()
        needs_env(self, env, "the steps of its worlds")
        self.shape = (env.num_envs, 1)
        self.terms = {}
        for name, entry in terms.items():
            if entry is None:
                continue
            if not (isinstance(entry, (list, tuple)) and len(entry) == 2):
                raise ValueError(f"terms.{name} must be [weight, function], got {entry}.")
            weight, term = entry
            if weight is None:
                continue
            if not callable(term):
                raise ValueError(f"terms.{name} must be [weight, function], got {entry}.")
            if not isinstance(weight, (int, float)):
                raise ValueError(f"terms.{name} must have a number as its weight, got {weight}.")
            with named(f"terms.{name}"):
                bound = bind(term, robot=env.robot, joint_range=env.joint_range)
            self.terms[name] = weight, bound
        if not self.terms:
            raise ValueError("terms must hold at least one term with a weight.")

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        reward: Any = 0.0
        for name, (weight, term) in self.terms.items():
            try:
                value = weight * term(tensordict, next_tensordict)
            except KeyError as error:
                raise ValueError(
                    f"terms.{name} reads what is not there: {error.args[0]}"
                ) from error
            except Exception as error:
                raise ValueError(f"terms.{name} failed: {in_one_line(error)}") from error
            if value.shape != self.shape:
                raise ValueError(
                    f"terms.{name} must return {self.shape}, one number per world, "
                    f"got {tuple(value.shape)}."
                )
            if not math.isfinite(value.sum()):
                _refuse(name, value)
            next_tensordict["reward_terms", name] = value
            reward = reward + value
        return next_tensordict.set("reward", reward)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        base_env_of(self)
        zero = tensordict_reset["done"].float()
        for name in self.terms:
            tensordict_reset["reward_terms", name] = zero.clone()
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for name in self.terms:
            observation_spec["reward_terms", name] = Unbounded((*observation_spec.shape, 1))
        return observation_spec

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        reward_spec["reward"] = Unbounded((*reward_spec.shape, 1))
        return reward_spec


def _refuse(name: str, value: Tensor) -> None:
    """Raises ``ValueError`` if a term has a value that is not finite; large ones may be."""
    bad = (~value.isfinite()).nonzero()
    if len(bad):
        world = int(bad[0, 0])
        raise ValueError(
            f"terms.{name} must be finite, got {value[world, 0]:g} in world {world}: it divides by "
            "0, for instance, or reads what a transform has made so."
        )
