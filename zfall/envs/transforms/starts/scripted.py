"""Starts that are given beforehand."""

from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.placing import START_KEYS
from zfall.envs.transforms.base_env import base_env_of, needs_env


class ScriptedStart(Transform):
    """Starts every world in a state given beforehand.

    Writes the keys ``("start", NAME)`` for the reset of the base env, NAME being one of
    ``zfall.envs.placing.START_KEYS``, from ``states``, which may be changed between episodes.

    Args:
        env: the base env.
        states: by name, values ``(N, ...)`` for each world.

    Raises:
        ValueError: on a name that is not one of ``START_KEYS``.
    """

    replaced_in_batteries = True  # by starts of a battery

    def __init__(self, env: HumanoidEnv, *, states: dict[str, Tensor]):
        super().__init__()
        needs_env(self, env, "the begin of episodes")
        unknown = sorted(set(states) - set(START_KEYS))
        if unknown:
            raise ValueError(f"states must be of {', '.join(START_KEYS)}, got {unknown[0]}.")
        self.states, self.num_envs = states, env.num_envs

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        base_env_of(self)
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        for name, value in self.states.items():
            tensordict["start", name] = value
        return tensordict
