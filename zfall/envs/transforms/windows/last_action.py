"""The action of the step before."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.on_robot import Known, OnRobot
from zfall.envs.transforms.base_env import needs_steps


class LastAction(Transform):
    """Keeps the action of the step just taken.

    Keys: writes ``last_action`` ``(N, J)``, zero after a reset. In a reward term,
    ``td["last_action"]`` is thus the action before ``td["action"]``.

    Raises:
        ValueError: if no transform of the env takes an action.
    """

    units: ClassVar[Mapping[str, str]] = {"last_action": "1"}

    def __init__(self) -> None:
        super().__init__(in_keys=["action"], out_keys=["last_action"])
        needs_steps(self, "the step before")

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("last_action", tensordict["action"].clone())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset.set("last_action", self.parent.full_action_spec["action"].zero())

    def on_robot(self) -> OnRobot:
        """The same on a robot."""
        return _LastActionOnRobot(self.parent.full_action_spec["action"].shape[-1])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        actions = self.parent.full_action_spec
        if "action" not in actions.keys():
            raise ValueError(
                f"LastAction needs an action, as JointPositionTarget brings it, got an env that "
                f"reads {', '.join(map(str, actions.keys()))}."
            )
        # Policies may go beyond the bounds of an action, where it does what the bound does.
        observation_spec["last_action"] = Unbounded(actions["action"].shape)
        return observation_spec


class _LastActionOnRobot(OnRobot):
    def __init__(self, joints: int):
        super().__init__([], ["last_action"], {"last_action": torch.zeros(1, joints)})

    def observe(self, known: Known) -> None:
        known["last_action"] = known["state", "last_action"]

    def act(self, known: Known) -> None:
        known["next", "last_action"] = known["action"]
