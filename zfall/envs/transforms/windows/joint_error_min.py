"""How close the robot has come to its reference."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.values import reset_rows
from zfall.envs.transforms.windows.length import window_steps
from zfall.values import Positive


class JointErrorMin(Transform):
    """Keeps the smallest distance from the standing reference pose in a window of time.

    ``min |q(t') - q0|`` over t' in [t - seconds, t], both ends included. Before the reset the
    distance counts as 0: what bounds it from below says nothing until a window has passed.

    Keys: reads ``joint_position`` ``(N, J)`` [rad]; writes ``joint_error_min`` ``(N, 1)`` [rad].

    Args:
        env: the base env.
        seconds: length of the window [s].
        joints: those that count, ``legs`` or ``all``.

    Raises:
        ValueError: if the window is shorter than a control step, or on other joints.

    Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning",
    IROS 2022, section IV-C.5; that robot's motors are those of its legs.
    """

    history: Tensor
    slot: Tensor
    index: Tensor
    reference: Tensor

    def __init__(self, env: HumanoidEnv, *, seconds: Positive, joints: str = "legs"):
        super().__init__(in_keys=["joint_position"], out_keys=["joint_error_min"])
        needs_env(self, env, "a memory of each world")
        self.steps = window_steps(seconds, env.control_dt) + 1
        self.register_buffer("index", torch.tensor(env.robot.index_of(joints)))
        self.register_buffer("reference", env.stand_position[self.index])
        # A ring of the last distances, the same slot in all worlds; each step writes one of them.
        self.register_buffer("history", torch.zeros(self.steps, env.num_envs))
        self.register_buffer("slot", torch.zeros((), dtype=torch.long))

    def _error(self, tensordict: TensorDictBase) -> Tensor:
        position = tensordict["joint_position"].index_select(-1, self.index)
        return (position - self.reference).norm(dim=-1)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        slot = (int(self.slot) + 1) % self.steps
        self.slot.fill_(slot)
        self.history[slot] = self._error(next_tensordict)
        return next_tensordict.set(self.out_keys[0], self.history.amin(0)[:, None])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.history[:, rows] = 0.0
        self.history[int(self.slot), rows] = self._error(tensordict_reset)[rows]
        return tensordict_reset.set(self.out_keys[0], self.history.amin(0)[:, None])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        observation_spec[self.out_keys[0]] = Unbounded((*observation_spec.shape, 1))
        return observation_spec
