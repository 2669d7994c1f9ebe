"""From the policy's action to the servos' targets."""

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.starts import reset_rows


class JointPositionTarget(Transform):
    """Reads the action as joint angles around the standing reference pose.

    ``target = clamp(reference + scale * action, joint range)``.

    Keys: reads ``action`` ``(N, J)``, writes ``target`` ``(N, J)`` [rad], for the step and as an
    observation; after a reset it is the reference. The action has no bounds of its own.

    Args:
        env: the base env.
        scale: angle of an action of 1 [rad].

    Raises:
        ValueError: if ``scale`` is not positive.
    """

    reference: Tensor
    range: Tensor

    def __init__(self, env: HumanoidEnv, *, scale: float):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["action"])
        if not scale > 0:
            raise ValueError(f"scale must be positive, got {scale}.")
        self.scale = scale
        self.register_buffer("reference", env.stand_position)
        self.register_buffer("range", env.joint_range)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        low, high = self.range.unbind(-1)
        target = self.reference + self.scale * tensordict["action"]
        return tensordict.set("target", torch.clamp(target, low, high))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("target", tensordict["target"])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        target = self.reference.expand(*tensordict_reset.batch_size, -1).clone()
        return tensordict_reset.set("target", target)

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        control = input_spec["full_action_spec"].pop("control")
        shape = (*control.shape[:-2], control.shape[-1])
        input_spec["full_action_spec", "action"] = Unbounded(shape)
        return input_spec

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["target"] = Unbounded((*observation_spec.shape, len(self.reference)))
        return observation_spec


class ActuatorDelay(Transform):
    """Lets the servos follow their targets a little late, each world by its own delay.

    A delay is drawn per episode, uniform between its bounds, and rounded to physics steps: the
    target commanded at time t acts on the physics steps from t + delay on. Before the first
    command has arrived the servos hold the standing reference.

    Keys: reads ``target`` ``(N, J)`` [rad], writes ``control`` ``(N, S, J)`` [rad].

    Args:
        env: the base env.
        delay: shortest and longest delay [s].
        max_delay: length of the buffer [s]; what ``delay`` may be set to later.

    Raises:
        ValueError: if the delays are not in order within [0, max_delay].
    """

    history: Tensor
    lag: Tensor
    substep: Tensor
    reference: Tensor

    def __init__(self, env: HumanoidEnv, *, delay: tuple[float, float], max_delay: float = 0.1):
        super().__init__(in_keys_inv=["control"], out_keys_inv=["target"])
        if not 0 <= delay[0] <= delay[1] <= max_delay:
            raise ValueError(
                f"delay must be [shortest, longest] within [0, max_delay], got {list(delay)} "
                f"with max_delay {max_delay}."
            )
        self.delay, self.max_delay, self.rng = delay, max_delay, env.rng
        self.physics_dt, self.substeps = env.physics_dt, env.substeps
        length = 1 + math.ceil(round(max_delay / env.physics_dt) / env.substeps)
        self.register_buffer("reference", env.stand_position)
        # The last commands of every world, newest last, and its delay in physics steps.
        self.register_buffer("history", env.stand_position.repeat(env.num_envs, length, 1))
        self.register_buffer("lag", torch.zeros(env.num_envs, dtype=torch.long))
        self.register_buffer("substep", torch.arange(env.substeps))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.history = torch.cat([self.history[:, 1:], tensordict["target"][:, None]], 1)
        # At physics step s the newest command is s steps old, the one before it s + S, ...
        age = torch.ceil((self.lag[:, None] - self.substep) / self.substeps).clamp_min(0).long()
        index = self.history.shape[1] - 1 - age
        index = index[..., None].expand(-1, -1, self.history.shape[-1])
        return tensordict.set("control", self.history.gather(1, index))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict)
        low, high = self.delay
        seconds = low + (high - low) * torch.rand(len(rows), generator=self.rng)
        lag = torch.round(seconds / self.physics_dt).long()
        self.lag = torch.where(rows, lag, self.lag)
        self.history = torch.where(rows[:, None, None], self.reference, self.history)
        return tensordict_reset
