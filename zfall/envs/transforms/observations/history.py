"""What was measured in the steps before."""

from contextlib import suppress

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.mirror import Permutation, mirror_quantity
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.observations.measured import read_measured
from zfall.envs.transforms.values import reset_rows
from zfall.values import Count, Names


class ObservationHistory(Transform):
    """Keeps what was measured in the control steps before, for a policy without a memory.

    Each quantity of size D gives ``steps x D`` numbers, the step just before first. After a reset
    all of them are what is measured then, as if the robot had stood so before. Mirrored, each step
    is the image of that step; angles that the other side cannot take are not clamped.

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
        self.mirror_signs: dict[str, Permutation] = {}
        for key in self.keys:
            # Of a step's own value too: by the next step others may have written over it.
            self.register_buffer(f"past_{key}", torch.zeros(env.num_envs, 0))
            with suppress(ValueError):  # who mirrors what has no image is told then
                self.mirror_signs[f"history/{key}"] = self._mirror(env, key)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self.keys:
            now, past = self._flat(next_tensordict, key), getattr(self, f"past_{key}")
            next_tensordict["history", key] = past
            setattr(self, f"past_{key}", torch.cat([now, past[:, : -now.shape[1]]], -1))
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)[:, None]
        for key in self.keys:
            begin = self._flat(tensordict_reset, key).repeat(1, self.steps)
            past = getattr(self, f"past_{key}")
            tensordict_reset["history", key] = begin
            setattr(self, f"past_{key}", torch.where(rows, begin, past))
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for key in self.keys:
            if key not in observation_spec.keys(True):
                names = ", ".join(map(str, observation_spec.keys(True, True)))
                raise ValueError(f"keys must name quantities made before it ({names}), got {key}.")
            worlds, *shape = observation_spec[key].shape
            size = (worlds, self.steps * torch.Size(shape).numel())
            observation_spec["history", key] = Unbounded(size)
            if getattr(self, f"past_{key}").shape != size:  # only now known
                setattr(self, f"past_{key}", torch.zeros(size))
        return observation_spec

    def _flat(self, tensordict: TensorDictBase, key: str) -> Tensor:
        return read_measured(tensordict, key).flatten(1)

    def _mirror(self, env: HumanoidEnv, key: str) -> Permutation:
        places, signs = mirror_quantity(env.robot, key)
        return Permutation(
            [step * len(places) + place for step in range(self.steps) for place in places],
            list(signs) * self.steps,
        )
