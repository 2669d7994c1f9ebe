"""How far the robot has gone and turned."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.values import reset_rows
from zfall.envs.transforms.windows.length import window_steps
from zfall.rotations import heading, wrap
from zfall.values import Positive


class OdometryDisplacement(Transform):
    """Compares the odometry pose with that of a while ago.

    ``p(t) - p(t - seconds)`` with ``p = (x, y, heading)`` of the base, the turn wrapped to
    [-pi, pi); in the first ``seconds`` of an episode ``p(t) - p(0)``.

    Keys: reads ``base_position`` ``(N, 3)`` [m] and ``base_orientation`` ``(N, 4)``; writes
    ``odometry_displacement`` ``(N, 3)`` [m, m, rad; world axes].

    Args:
        env: the base env.
        seconds: length of the window [s].

    Raises:
        ValueError: if the window is shorter than a control step.

    Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning",
    IROS 2022, section IV-C.4, in world axes as printed there.
    """

    history: Tensor
    begin: Tensor
    age: Tensor
    slot: Tensor

    def __init__(self, env: HumanoidEnv, *, seconds: Positive):
        super().__init__(
            in_keys=["base_position", "base_orientation"], out_keys=["odometry_displacement"]
        )
        needs_env(self, env, "a memory of each world")
        self.steps = window_steps(seconds, env.control_dt)
        # A ring of the last poses, the same slot in all worlds; each step writes one of them.
        self.register_buffer("history", torch.zeros(self.steps, env.num_envs, 3))
        self.register_buffer("begin", torch.zeros(env.num_envs, 3))
        self.register_buffer("age", torch.zeros(env.num_envs, 1, dtype=torch.long))
        self.register_buffer("slot", torch.zeros((), dtype=torch.long))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        pose = _pose(next_tensordict)
        slot = int(self.slot)
        self.age += 1
        old = torch.where(self.age > self.steps, self.history[slot], self.begin)
        self.history[slot] = pose
        self.slot.fill_((slot + 1) % self.steps)
        displacement = pose - old
        displacement[:, 2] = wrap(displacement[:, 2])
        return next_tensordict.set(self.out_keys[0], displacement)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows, pose = reset_rows(tensordict, self), _pose(tensordict_reset)
        self.begin[rows] = pose[rows]
        self.age[rows] = 0
        return tensordict_reset.set(self.out_keys[0], torch.zeros_like(pose))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        observation_spec[self.out_keys[0]] = Unbounded(self.begin.shape)
        return observation_spec


def _pose(tensordict: TensorDictBase) -> Tensor:
    angle = heading(tensordict["base_orientation"])
    return torch.cat([tensordict["base_position"][:, :2], angle], -1)
