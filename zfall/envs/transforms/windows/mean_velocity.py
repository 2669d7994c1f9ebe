"""How fast the base went, on average."""

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.rotations import heading, rotation_vector, turn_between, wrap


class MeanVelocity(Transform):
    """Takes the mean velocities of the base in a control step from where it was and is.

    ``odometry_velocity = (x' - x, y' - y, heading' - heading) / control_dt``, and the mean angular
    velocity is the turn from the old to the new orientation over ``control_dt``, exact for a
    turn about one axis.

    Keys: reads ``base_position`` ``(N, 3)`` [m] and ``base_orientation`` ``(N, 4)`` before and
    after the step; writes ``odometry_velocity`` ``(N, 3)`` [m/s, m/s, rad/s; world] and
    ``base_mean_angular_velocity`` ``(N, 3)`` [rad/s; body], 0 after a reset.

    Args:
        env: the base env.

    Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning",
    IROS 2022, section IV-D: averages since the previous step.
    """

    def __init__(self, env: HumanoidEnv):
        super().__init__(
            in_keys=["base_position", "base_orientation"],
            out_keys=["odometry_velocity", "base_mean_angular_velocity"],
        )
        needs_env(self, env, "the steps of its worlds")
        self.control_dt = env.control_dt

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        old, new = tensordict["base_orientation"], next_tensordict["base_orientation"]
        moved = next_tensordict["base_position"] - tensordict["base_position"]
        before, after = heading(torch.stack([old, new]))
        turned = wrap(after - before)
        velocity = torch.cat([moved[:, :2], turned], -1) / self.control_dt
        turning = rotation_vector(turn_between(old, new)) / self.control_dt
        next_tensordict["odometry_velocity"] = velocity
        return next_tensordict.set("base_mean_angular_velocity", turning)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        base_env_of(self)
        for key in self.out_keys:
            tensordict_reset[key] = torch.zeros_like(tensordict_reset["base_position"])
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for key in self.out_keys:
            observation_spec[key] = Unbounded((*observation_spec.shape, 3))
        return observation_spec
