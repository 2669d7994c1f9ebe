"""What was measured in the steps before."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.mirror import Permutation, mirror_quantity
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.observations.measured import read_measured
from zfall.values import Count, Names


class ObservationHistory(Transform):
    """Keeps what was measured in the control steps before, for a policy without a memory.

    Each quantity of size D gives ``steps x D`` numbers, the step just before first. After a reset
    all of them are what is measured then: the robot was at rest.

    Keys: reads ``keys``, as measured where they are; writes ``("history", key)``
    ``(N, steps * D)``, which ``ObservationVector`` lines up: ``keys: [tilt, [history, tilt]]``.

    Args:
        env: the base env.
        keys: names of quantities, flattened.
        steps: control steps to look back.

    Raises:
        ValueError: on a key that no transform before it writes.
    """

    measured = True

    def __init__(self, env: HumanoidEnv, *, keys: Names, steps: Count):
        super().__init__(in_keys=list(keys), out_keys=[("history", key) for key in keys])
        needs_env(self, env, "the steps before")
        self.keys, self.steps = list(keys), steps
        self.mirror_signs = {f"history/{key}": self._mirror(env, key) for key in self.keys}

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self.keys:
            before = self._flat(tensordict, key)
            older = tensordict["history", key][..., : -before.shape[-1]]
            next_tensordict["history", key] = torch.cat([before, older], -1)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        base_env_of(self)
        for key in self.keys:
            now = self._flat(tensordict_reset, key)
            tensordict_reset["history", key] = now.repeat(1, self.steps)
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for key in self.keys:
            if key not in observation_spec.keys(True):
                names = ", ".join(map(str, observation_spec.keys(True, True)))
                raise ValueError(f"keys must name quantities made before it ({names}), got {key}.")
            worlds, *shape = observation_spec[key].shape
            size = self.steps * torch.Size(shape).numel()
            observation_spec["history", key] = Unbounded((worlds, size))
        return observation_spec

    def _flat(self, tensordict: TensorDictBase, key: str) -> Tensor:
        return read_measured(tensordict, key).flatten(1)

    def _mirror(self, env: HumanoidEnv, key: str) -> Permutation:
        places, signs = mirror_quantity(env.robot, key)
        return Permutation(
            [step * len(places) + place for step in range(self.steps) for place in places],
            list(signs) * self.steps,
        )
