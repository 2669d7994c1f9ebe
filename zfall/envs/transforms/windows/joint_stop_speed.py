"""How hard the joints hit their stops."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, check_recorded, needs_env


class JointStopSpeed(Transform):
    """Keeps the largest speed with which a joint was at a stop during the control step.

    ``max |v_j|`` over the joints and physics steps with ``q_j <= low_j`` or ``q_j >= high_j``,
    0 if there are none. After physics steps, not control steps: a stop takes the speed away
    within a few of them.

    Keys: reads ``("substeps", "joint_position")`` [rad] and ``("substeps", "joint_velocity")``
    [rad/s] ``(N, S, J)``; writes ``joint_stop_speed`` ``(N, 1)`` [rad/s], 0 after a reset.

    Args:
        env: the base env, which is made to record positions and velocities.

    Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning",
    IROS 2022, section IV-C.3.
    """

    range: Tensor

    def __init__(self, env: HumanoidEnv):
        super().__init__(
            in_keys=[("substeps", "joint_position"), ("substeps", "joint_velocity")],
            out_keys=["joint_stop_speed"],
        )
        needs_env(self, env, "physics steps that it records")
        env.record_substeps(["joint_position", "joint_velocity"])
        self.register_buffer("range", env.joint_range)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        position, velocity = (next_tensordict[key] for key in self.in_keys)
        low, high = self.range.unbind(-1)
        at_stop = (position <= low) | (position >= high)
        speed = torch.where(at_stop, velocity.abs(), 0.0).flatten(1).amax(-1, keepdim=True)
        return next_tensordict.set(self.out_keys[0], speed)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        base_env_of(self)
        speed = tensordict_reset["joint_velocity"].new_zeros(*tensordict_reset.shape, 1)
        return tensordict_reset.set(self.out_keys[0], speed)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        check_recorded(self, observation_spec, ["joint_position", "joint_velocity"])
        observation_spec[self.out_keys[0]] = Unbounded((*observation_spec.shape, 1))
        return observation_spec
