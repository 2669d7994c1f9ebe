"""Starts in the standing pose with noise."""

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import needs_env, streams_of
from zfall.envs.transforms.values import per_world, refuse_start, reset_rows, two_numbers
from zfall.values import Bounds, NotNegative


class NoisyStart(Transform):
    """Starts episodes in the standing pose with Gaussian noise, over the floor or on it.

    Writes ``("start", "joint_position")`` [rad] and ``("start", "joint_velocity")`` [rad/s]
    ``(N, J)`` for the reset of the base env; angles are clamped to the joint ranges. With a
    clearance also ``("start", "clearance")`` ``(N, 1)`` [m].

    Args:
        env: the base env.
        joint_position: standard deviation of each angle [rad].
        joint_velocity: standard deviation of each speed [rad/s].
        clearance: smallest and largest height of the lowest corner of the soles above the floor
            [m], uniform; what is drawn below 0 is 0. On the floor if ``null``.

    Raises:
        ValueError: on a negative standard deviation, or a clearance that is no range; at a
            reset, after another start of the whole state.
    """

    replaced_in_batteries = True  # by starts of a battery

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        joint_position: NotNegative = 0.0,
        joint_velocity: NotNegative = 0.0,
        clearance: Bounds | None = None,
    ):
        super().__init__()
        needs_env(self, env, "the begin of episodes")
        for name, std in (("joint_position", joint_position), ("joint_velocity", joint_velocity)):
            if std < 0:
                raise ValueError(f"{name} must not be negative, got {std}.")
        self.clearance = None if clearance is None else list(two_numbers("clearance", clearance))
        if self.clearance is not None and not self.clearance[0] <= self.clearance[1]:
            raise ValueError(f"clearance must be [smallest, largest], got {list(self.clearance)}.")
        self.joint_position, self.joint_velocity = joint_position, joint_velocity
        self.stand, self.range = env.stand_position, env.joint_range
        self.num_envs = env.num_envs

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        refuse_start(self, tensordict, "base_orientation")
        rows = reset_rows(tensordict)
        noise = streams_of(self).normal((2, len(self.stand)), rows)
        low, high = self.range.unbind(-1)
        angle = self.stand + per_world(self.joint_position, 2) * noise[:, 0]
        tensordict["start", "joint_position"] = torch.clamp(angle, low, high)
        tensordict["start", "joint_velocity"] = per_world(self.joint_velocity, 2) * noise[:, 1]
        if self.clearance is not None:
            least, most = (per_world(bound, 2) for bound in self.clearance)
            u = streams_of(self).uniform((1,), rows)
            tensordict["start", "clearance"] = torch.clamp_min(least + (most - least) * u, 0.0)
        return tensordict
