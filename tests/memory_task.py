"""A task for a memory: told once which way to act, asked a second later."""

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, InitTracker, RewardSum, TransformedEnv

STEPS = 26  # the first, and what of 25 Hz makes up a second


class RecallEnv(EnvBase):
    """The observation is a push direction, +1 or -1, at the first step, and 0 after it.

    At the last step of 26 the reward is ``-(action - direction)^2``, before it 0. A policy without
    memory cannot do better than the action 0, at -1.

    Args:
        num_envs: number of worlds.
    """

    control_dt = 0.04

    def __init__(self, num_envs: int):
        super().__init__(batch_size=[num_envs])
        n = num_envs
        shapes = {"observation": Unbounded((n, 2)), "observation_critic": Unbounded((n, 3))}
        self.observation_spec = Composite(shapes, shape=(n,))
        self.full_action_spec = Composite(action=Unbounded((n, 1)), shape=(n,))
        self.full_reward_spec = Composite(reward=Unbounded((n, 1)), shape=(n,))
        flags = {key: Binary(1, (n, 1), dtype=torch.bool) for key in ("done", "terminated")}
        self.full_done_spec = Composite(flags, shape=(n,))
        self.direction = torch.zeros(n, 1)
        self.count = torch.zeros(n, 1)

    def _observe(self) -> dict[str, torch.Tensor]:
        shown = torch.where(self.count == 0, self.direction, 0.0)
        phase = self.count / STEPS
        known = [self.direction, phase, phase == (STEPS - 1) / STEPS]
        return {
            "observation": torch.cat([shown, phase], -1),
            "observation_critic": torch.cat(known, -1).float(),
        }

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        rows = torch.ones(self.batch_size[0], 1, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict.keys():
            rows = tensordict["_reset"].reshape(-1, 1)
        drawn = 2.0 * torch.randint(2, self.direction.shape) - 1.0
        self.direction = torch.where(rows, drawn, self.direction)
        self.count = torch.where(rows, 0.0, self.count)
        off = torch.zeros_like(rows)
        return TensorDict(
            {**self._observe(), "done": off, "terminated": off.clone()}, self.batch_size
        )

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        last = self.count == STEPS - 1
        error = (tensordict["action"] - self.direction).square()
        self.count = self.count + 1
        return TensorDict(
            {
                **self._observe(),
                "reward": torch.where(last, -error, 0.0),
                "done": last,
                "terminated": last.clone(),
            },
            self.batch_size,
        )

    def _set_seed(self, seed: int | None) -> None:
        torch.manual_seed(seed or 0)


def make_env(num_envs: int) -> TransformedEnv:
    """The task with what learning reads."""
    return TransformedEnv(RecallEnv(num_envs), Compose(InitTracker(), RewardSum()))
