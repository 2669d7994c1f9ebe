"""Servos that stop once the robot rests."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.actions.commands import targets_before
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.values import reset_rows
from zfall.falling.modes.machine import STABLE


class StableHold(Transform):
    """Keeps the last target of the servos in mode STABLE, whatever the policy does.

    Keys: reads ``mode`` ``(N, 3)``; changes ``target`` ``(N, J)`` [rad] and, where there is one,
    ``control`` ``(N, S, J)`` [rad]. Comes after the transforms that make these. An episode that
    begins in STABLE keeps ``("start", "target")``, or the angles of its joints.

    Args:
        env: the base env.

    Raises:
        ValueError: in the first step, if nothing writes ``mode``.
    """

    held: Tensor

    def __init__(self, env: HumanoidEnv):
        keys = ["target", "control"]
        super().__init__(in_keys_inv=keys, out_keys_inv=keys)
        needs_env(self, env, "a memory of each world's commands")
        self.register_buffer("held", env.stand_position.repeat(env.num_envs, 1))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        base_env_of(self)
        mode = tensordict.get("mode", None)
        if mode is None:
            raise ValueError("StableHold needs the key mode: put a ModeMachine into the table.")
        stable = mode[:, STABLE, None] > 0
        self.held = torch.where(stable, self.held, tensordict["target"])
        control = tensordict.get("control", None)
        if control is not None:
            control = torch.where(stable[:, None], self.held[:, None], control)
            tensordict["control"] = control
        return tensordict.set("target", self.held.clone())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)[:, None]
        before = targets_before(tensordict, tensordict_reset["joint_position"])
        self.held = torch.where(rows, before, self.held)
        return tensordict_reset
