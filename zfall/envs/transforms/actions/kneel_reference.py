"""The pose around which a policy acts while it kneels."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.starts import reset_rows


class KneelReference(Transform):
    """Moves the reference of the targets from standing to the robot's kneel once it is to kneel.

    ``target = clamp(target + way - stand, joint range)``: ``way`` is the standing pose in mode
    RECOVER, from where in the other modes every joint goes to the kneel at ``speed``. A policy
    that does nothing so kneels by script; one that learns corrects the script.

    Keys: reads ``mode``, changes ``target`` ``(N, J)`` [rad]; comes after what makes it.

    Args:
        env: the base env.
        speed: of each joint [rad/s].

    Raises:
        ValueError: if the robot has no kneel, or ``speed`` is not positive.
    """

    way: Tensor

    def __init__(self, env: HumanoidEnv, *, speed: float = 4.0):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["target"])
        if not env.robot.kneel:
            raise ValueError(f"KneelReference needs a robot with a kneel, not {env.robot.name}.")
        if not speed > 0:
            raise ValueError(f"speed must be positive, got {speed}.")
        self.speed, self.control_dt = speed, env.control_dt
        self.stand, self.range = env.stand_position, env.joint_range
        self.kneel = torch.tensor(env.robot.kneel_position)
        self.register_buffer("way", env.stand_position.repeat(env.num_envs, 1))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        mode = tensordict.get("mode", None)
        if mode is None:
            raise ValueError("KneelReference needs the key mode: put a ModeMachine into the table.")
        reach = self.speed * self.control_dt
        further = self.way + (self.kneel - self.way).clamp(-reach, reach)
        self.way = torch.where(mode[:, :1] > 0, self.stand, further)
        target = tensordict["target"] + self.way - self.stand
        return tensordict.set("target", torch.clamp(target, *self.range.unbind(-1)))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        self.way = torch.where(reset_rows(tensordict)[:, None], self.stand, self.way)
        return tensordict_reset
