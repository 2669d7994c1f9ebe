"""The probability of a fall as a quantity of the env."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.observations.measured import read_measured
from zfall.envs.transforms.values import reset_rows
from zfall.values import Names


class FallPredictor(Transform):
    """Writes after every step the probability that a fall can no longer be avoided.

    Keys: reads ``keys``, measured where sensing comes earlier in the table; writes
    ``fall_probability`` ``(N, 1)``, 0 after a reset. The network's memory is zero at the begin of
    an episode. It knows nothing of robots that lie: where the step began in another ``mode`` than
    RECOVER the probability is 0, and the memory begins anew.

    Args:
        env: the base env.
        network: a module with ``hidden_size`` that takes measurements ``(N, D)`` and a memory
            ``(N, H)`` and returns a probability ``(N, 1)`` and the next memory.
        keys: the quantities that it was trained with, in order.

    Raises:
        ValueError: if the network was trained with other quantities or at another rate; in the
            first step, if the quantities have another size.
    """

    memory: Tensor
    measured = True  # sensing must come before it

    def __init__(self, env: HumanoidEnv, *, network: Any, keys: Names):
        super().__init__(in_keys=list(keys), out_keys=["fall_probability"])
        needs_env(self, env, "a memory of each world")
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
        if "mode" in tensordict.keys():
            away = tensordict["mode"][:, :1] == 0
            probability = torch.where(away, 0.0, probability)
            self.memory = torch.where(away, 0.0, self.memory)
        return next_tensordict.set("fall_probability", probability)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.memory = torch.where(rows[:, None], 0.0, self.memory)
        return tensordict_reset.set("fall_probability", torch.zeros(len(rows), 1))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        observation_spec["fall_probability"] = Unbounded((*observation_spec.shape, 1))
        return observation_spec
