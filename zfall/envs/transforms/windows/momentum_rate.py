"""How fast the momentum changes."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.values import reset_rows


class MomentumRate(Transform):
    """Takes the rates of linear and angular momentum in a control step by their change.

    ``rate = (momentum' - momentum) / time``: the mean total force, weight included, and the mean
    total moment about the center of mass. The mean and not the rate of the last physics step, as
    contacts make that one jump by several times the weight.

    ``time`` is ``control_dt``; in the first step of an episode it is one physics step less, by
    which momenta are older than the state after a step but not after a reset.

    Keys: reads ``linear_momentum`` [kg m/s] and ``angular_momentum`` [kg m2/s] ``(N, 3)`` before
    and after the step; writes ``momentum_rate`` [N] and ``angular_momentum_rate`` [N m]
    ``(N, 3)`` [world], 0 after a reset.

    Args:
        env: the base env.
    """

    time: Tensor

    def __init__(self, env: HumanoidEnv):
        super().__init__(
            in_keys=["linear_momentum", "angular_momentum"],
            out_keys=["momentum_rate", "angular_momentum_rate"],
        )
        needs_env(self, env, "a memory of each world")
        self.control_dt = env.control_dt
        # With one physics step only, nothing is known of the first: the change is 0, not 0 / 0.
        self.first = max(env.control_dt - env.physics_dt, env.physics_dt)
        self.register_buffer("time", torch.full((env.num_envs, 1), self.first))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            change = next_tensordict[key] - tensordict[key]
            next_tensordict[out_key] = change / self.time
        self.time.fill_(self.control_dt)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        self.time[reset_rows(tensordict, self)] = self.first
        for key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            tensordict_reset[out_key] = torch.zeros_like(tensordict_reset[key])
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for key in self.out_keys:
            observation_spec[key] = Unbounded((*observation_spec.shape, 3))
        return observation_spec
