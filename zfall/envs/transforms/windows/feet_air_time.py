"""How long the feet have been in the air."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.values import reset_rows


class FeetAirTime(Transform):
    """Counts the time since each foot left the floor.

    A control step at whose end a foot is in the air adds its whole length, one at whose end it
    touches the floor sets the time to 0; what happens in between is not seen. A foot has thus
    touched down in a step where it was above 0 before and is 0 after, and the time before is how
    long it was in the air. An episode that begins with a foot in the air begins with 0.

    Keys: reads ``feet_contact`` ``(N, 2)``, writes ``feet_air_time`` ``(N, 2)`` [s].

    Args:
        env: the base env.
    """

    time: Tensor

    def __init__(self, env: HumanoidEnv):
        super().__init__(in_keys=["feet_contact"], out_keys=["feet_air_time"])
        needs_env(self, env, "a memory of each world")
        self.control_dt = env.control_dt
        self.register_buffer("time", torch.zeros(env.num_envs, 2))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        contact = next_tensordict["feet_contact"]
        self.time = (self.time + self.control_dt).masked_fill_(contact, 0.0)
        return next_tensordict.set("feet_air_time", self.time.clone())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        self.time = self.time.masked_fill(reset_rows(tensordict, self)[:, None], 0.0)
        return tensordict_reset.set("feet_air_time", self.time.clone())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        observation_spec["feet_air_time"] = Unbounded(self.time.shape)
        return observation_spec
