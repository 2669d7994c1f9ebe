"""What was hardest in an episode so far."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.values import reset_rows


class LargestSoFar(Transform):
    """Keeps the largest value of some quantities since the episode began, 0 at the reset.

    With it a reward can count the hardest shock of a fall alone. NaN leaves the largest as it was.

    Keys: reads the keys of ``keys`` ``(N, D)``, which are never negative; writes their values
    ``(N, D)``.

    Args:
        env: the base env.
        keys: ``{read: written}``, as in ``{base_acceleration_peak: base_acceleration_max}``.

    Raises:
        ValueError: if there is none, one that the base env does not measure or whose values are no
            vectors, or a name that is taken.
    """

    def __init__(self, env: HumanoidEnv, *, keys: Mapping[str, str]):
        if not keys:
            raise ValueError("keys must name at least one quantity, got none.")
        for key in keys:
            if key not in env.observation_spec.keys():
                raise ValueError(f"keys must name quantities of the base env, got {key}.")
            if env.observation_spec[key].ndim != 2:
                raise ValueError(f"keys must name quantities of one number or a row, got {key}.")
        names = list(keys.values())
        for name in names:
            if name in env.observation_spec.keys() or names.count(name) > 1:
                raise ValueError(f"keys must be written to names of their own, {name} is taken.")
        super().__init__(in_keys=list(keys), out_keys=list(keys.values()))
        needs_env(self, env, "a memory of each world")
        self.mirror_like = {name: key for key, name in keys.items()}
        for key, name in keys.items():
            self.register_buffer(name, torch.zeros(env.observation_spec[key].shape))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key, name in zip(self.in_keys, self.out_keys, strict=True):
            largest = torch.fmax(getattr(self, name), next_tensordict[key])
            setattr(self, name, largest)
            next_tensordict.set(name, largest)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        new = reset_rows(tensordict, self)[:, None]
        for name in self.out_keys:
            largest = torch.where(new, 0.0, getattr(self, name))
            setattr(self, name, largest)
            tensordict_reset.set(name, largest)
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for name in self.out_keys:
            observation_spec[name] = Unbounded(getattr(self, name).shape)
        return observation_spec
