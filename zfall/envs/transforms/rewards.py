"""The reward: a table of weighted terms."""

from collections.abc import Callable
from typing import Any

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms import bind


class WeightedReward(Transform):
    """Sums reward terms, and keeps the share of each.

    Keys: writes ``reward`` ``(N, 1)``, the sum over terms of weight x value, and each summand
    under ``("reward_terms", name)`` ``(N, 1)``. What the terms read is said where they stand.

    Args:
        env: the base env; terms that ask for ``robot`` or ``joint_range`` are given its own.
        terms: ``name: [weight, term]``, a term being a function of the TensorDicts before and
            after the step that returns ``(N, 1)``. A weight of ``null`` leaves the term out.

    Raises:
        ValueError: if no term is left.
    """

    def __init__(
        self, env: HumanoidEnv, *, terms: dict[str, tuple[float | None, Callable[..., Tensor]]]
    ):
        super().__init__()
        self.terms = {
            name: (weight, bind(term, robot=env.robot, joint_range=env.joint_range))
            for name, (weight, term) in terms.items()
            if weight is not None
        }
        if not self.terms:
            raise ValueError("terms must hold at least one term with a weight.")

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        reward: Any = 0.0
        for name, (weight, term) in self.terms.items():
            value = weight * term(tensordict, next_tensordict)
            next_tensordict["reward_terms", name] = value
            reward = reward + value
        return next_tensordict.set("reward", reward)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        zero = tensordict_reset["done"].float()
        for name in self.terms:
            tensordict_reset["reward_terms", name] = zero.clone()
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for name in self.terms:
            observation_spec["reward_terms", name] = Unbounded((*observation_spec.shape, 1))
        return observation_spec

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        reward_spec["reward"] = Unbounded((*reward_spec.shape, 1))
        return reward_spec
