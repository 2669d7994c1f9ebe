"""Noise by which a policy explores, where it is to last longer than a control step."""

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env, streams_of
from zfall.envs.transforms.values import reset_rows
from zfall.values import FractionBelowOne


class CorrelatedNoise(Transform):
    """Draws noise for the actions of which each control step keeps a part.

    ``noise' = c noise + sqrt(1 - c^2) n`` with n from N(0, 1): of standard deviation 1 in every
    step, as white noise is, but half of it is left after ``log(1/2) / log(c)`` steps, so that
    joints are led somewhere else and not just shaken. Training explores by it wherever it stands in
    the table (``zfall.modules.exploring.ExploringActor``), for a plain Gaussian alone.

    Keys: writes ``exploration_noise`` ``(N, J)``, anew with every episode.

    Args:
        env: the base env.
        correlation: between a step and the next, c in [0, 1).

    Raises:
        ValueError: if the correlation is not in that range.

    Source: Hollenstein et al., "Colored Noise in PPO: Improved Exploration and Performance through
    Correlated Action Sampling", AAAI 2024, whose noise is coloured by its spectrum.
    """

    noise: Tensor

    def __init__(self, env: HumanoidEnv, *, correlation: FractionBelowOne):
        super().__init__(out_keys=["exploration_noise"])
        needs_env(self, env, "a memory of each world")
        if not 0 <= correlation < 1:
            raise ValueError(f"correlation must lie in [0, 1), got {correlation}.")
        self.correlation = correlation
        self.register_buffer("noise", torch.zeros(env.num_envs, len(env.stand_position)))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        fresh = streams_of(self).normal(self.noise.shape[1:])
        rest = math.sqrt(1.0 - self.correlation**2)
        self.noise = self.correlation * self.noise + rest * fresh
        return next_tensordict.set("exploration_noise", self.noise)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        fresh = streams_of(self).normal(self.noise.shape[1:], rows)
        self.noise = torch.where(rows[:, None], fresh, self.noise)
        return tensordict_reset.set("exploration_noise", self.noise)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        observation_spec["exploration_noise"] = Unbounded(self.noise.shape)
        return observation_spec
