"""From the policy's action to the servos' targets."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.on_robot import Known, OnRobot
from zfall.envs.transforms.actions.action import read_action, replace_control
from zfall.envs.transforms.actions.commands import check_chain, refuse_commands, targets_before
from zfall.envs.transforms.values import per_world
from zfall.values import Positive


class JointPositionTarget(Transform):
    """Reads the action as joint angles around the standing reference pose.

    ``target = clamp(reference + scale * action, joint range)``.

    Keys: reads ``action`` ``(N, J)``, writes ``target`` ``(N, J)`` [rad], for the step and as an
    observation; after a reset it is the reference, in a recorded fall what it was then. The
    bounds of the action are those whose targets are the ends of the joint's range: an action
    beyond them does what the bound does. See ``read_action`` for what an action may be.

    Args:
        env: the base env.
        scale: angle of an action of 1 [rad].

    Raises:
        ValueError: if ``scale`` is not positive; at a reset or in a step, if a transform acts on
            commands before this one makes them.
    """

    units: ClassVar[Mapping[str, str]] = {"target": "rad"}

    reference: Tensor
    range: Tensor

    def __init__(self, env: HumanoidEnv, *, scale: Positive):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["action"])
        if not scale > 0:
            raise ValueError(f"scale must be positive, got {scale}.")
        self.scale = scale
        self.register_buffer("reference", env.stand_position)
        self.register_buffer("range", env.joint_range)

    def action_toward(self, pose: Tensor) -> Tensor:
        """The action whose target is a pose ``(*B, J)`` [rad]."""
        return (pose - self.reference) / self.scale

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        refuse_commands(self, tensordict)
        low, high = self.range.unbind(-1)
        action = read_action(tensordict, len(self.reference))
        target = self.reference + per_world(self.scale, 2) * action
        return tensordict.set("target", torch.clamp(target, low, high))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("target", tensordict["target"])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        check_chain(self)
        target = self.reference.expand(*tensordict_reset.batch_size, -1).clone()
        return tensordict_reset.set("target", targets_before(tensordict, target))

    def on_robot(self) -> OnRobot:
        """The same on a robot, which begins with the reference as its target."""
        return _PositionOnRobot(self.reference, self.range, float(self.scale))

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        scale = per_world(self.scale, 2)
        low, high = ((end - self.reference) / scale for end in self.range.unbind(-1))
        return replace_control(input_spec, low, high)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["target"] = Unbounded((*observation_spec.shape, len(self.reference)))
        return observation_spec


class _PositionOnRobot(OnRobot):
    def __init__(self, reference: Tensor, joint_range: Tensor, scale: float):
        super().__init__([], ["target"], {"target": reference[None].clone()})
        self.register_buffer("reference", reference.clone())
        self.register_buffer("range", joint_range.clone())
        self.scale = scale

    def observe(self, known: Known) -> None:
        known["target"] = known["state", "target"]

    def act(self, known: Known) -> None:
        low, high = self.get_buffer("range").unbind(-1)
        target = self.get_buffer("reference") + self.scale * known["action"]
        known["next", "target"] = torch.clamp(target, low, high)
        known["command"] = known["next", "target"][:, None]
