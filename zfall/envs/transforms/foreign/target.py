"""From the action of a policy of another framework to the servos' targets."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.actions.action import read_action
from zfall.envs.transforms.actions.commands import check_chain, refuse_commands, targets_before
from zfall.envs.transforms.foreign.joints import places, reference_pose
from zfall.values import Names


class ForeignJointTarget(Transform):
    """Reads the action as angles of some joints, in the policy's own order, around a reference.

    ``target = clamp(reference + scale * action, joint range)``; joints that the policy does not
    move stay at the reference.

    Keys: reads ``action`` ``(N, A)``, one number for each of ``joints``; writes ``target``
    ``(N, J)`` [rad] in the robot's order, after a reset the reference.

    Args:
        env: the base env.
        joints: names of the joints that the policy moves, in the order of its action.
        scale: angle of an action of 1 [rad], of all joints or of each.
        reference: angles by joint [rad]; of all others those of the robot's stand.

    Raises:
        ValueError: on a joint that the robot lacks or that is named twice, or scales that are 0
            or of another number.

    Source: ``JointPositionAction`` of Isaac Lab 2.3 and mjlab 1.6 (``offset + scale * action``,
    the offset is the default joint position) and MuJoCo Playground 0.2 (``default_pose + action *
    action_scale``). The clamp is ours: no servo follows beyond its range.
    """

    units: ClassVar[Mapping[str, str]] = {"target": "rad"}

    reference: Tensor
    range: Tensor
    scale: Tensor
    index: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        joints: Names,
        scale: float | Sequence[float],
        reference: Mapping[str, float] | None = None,
    ):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["action"])
        scales = torch.as_tensor(scale, dtype=torch.float32)
        if scales.dim() and len(scales) != len(joints):
            raise ValueError(
                f"scale must be a number, or one for each of {len(joints)} joints, "
                f"got {len(scales)}."
            )
        if not (scales != 0).all():
            raise ValueError(f"scale must not be 0, got {scale}.")
        self.register_buffer("index", places(env.robot, joints))
        self.register_buffer("scale", scales.expand(len(joints)).clone())
        self.register_buffer("reference", reference_pose(env, reference or {}))
        self.register_buffer("range", env.joint_range)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        refuse_commands(self, tensordict)
        low, high = self.range.unbind(-1)
        action = read_action(tensordict, len(self.index))
        target = self.reference.expand(*tensordict.batch_size, -1).clone()
        target[..., self.index] += self.scale * action
        return tensordict.set("target", torch.clamp(target, low, high))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("target", tensordict["target"])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        check_chain(self)
        target = self.reference.expand(*tensordict_reset.batch_size, -1).clone()
        return tensordict_reset.set("target", targets_before(tensordict, target))

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        actions = input_spec["full_action_spec"]
        shape = (*actions.pop("control").shape[:-2], len(self.index))
        ends = (self.range - self.reference[:, None])[self.index] / self.scale[:, None]
        low, high = (end.expand(shape).clone() for end in (ends.amin(-1), ends.amax(-1)))
        actions["action"] = Bounded(low, high, shape=shape, dtype=torch.float32)
        return input_spec

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["target"] = Unbounded((*observation_spec.shape, len(self.reference)))
        return observation_spec
