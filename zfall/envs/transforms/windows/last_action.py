"""The action of the step before."""

from tensordict import TensorDictBase
from torchrl.data import Composite
from torchrl.envs import Transform


class LastAction(Transform):
    """Keeps the action of the step just taken.

    Keys: writes ``last_action`` ``(N, J)``, zero after a reset. In a reward term,
    ``td["last_action"]`` is thus the action before ``td["action"]``.
    """

    def __init__(self) -> None:
        super().__init__(in_keys=["action"], out_keys=["last_action"])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("last_action", tensordict["action"].clone())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset.set("last_action", self.parent.full_action_spec["action"].zero())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["last_action"] = self.parent.full_action_spec["action"].clone()
        return observation_spec
