"""Advantages when the critic has a memory, and beside worlds that began alike."""

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.modules import set_recurrent_mode
from torchrl.objectives.value import GAE


class RecurrentGAE(GAE):
    """GAE from the values that a recurrent critic gave while the batch was collected.

    The critic runs once per step, beside the actor, as only then its memory at each step is
    known; what is added here is the value of the state that each step led to. Within an episode
    that is the value of the next step: the same state, the same memory. Where the episode or the
    batch ends, the critic takes one more step from the memory it had there: the step that
    follows belongs to another episode, or is not there yet. A terminated state counts as 0, a
    truncated one, and the end of the batch, by that value.

    Keys: as ``GAE``; reads ``state_value`` ``(N, T, 1)`` and, under ``"next"``, ``done`` and what
    the critic reads, in order of time; writes ``("next", "state_value")``.

    Args:
        critic: whose parameters are still those of collection.
        gamma, lmbda: discount, and weight of longer returns.
    """

    def __init__(self, critic: TensorDictModuleBase, *, gamma: float, lmbda: float):
        super().__init__(gamma=gamma, lmbda=lmbda, value_network=None)
        self.critic = critic

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``advantage`` and ``value_target`` ``(N, T, 1)``."""
        tensordict["next", "state_value"] = self._next_values(tensordict)
        return super().forward(tensordict)

    def _next_values(self, batch: TensorDictBase) -> Tensor:
        ends = batch["next", "done"].squeeze(-1).clone()
        ends[:, -1] = True
        values = batch["state_value"].roll(-1, 1)
        with set_recurrent_mode(False):
            values[ends] = self.critic(batch["next"].select(*self.critic.in_keys)[ends])[
                "state_value"
            ]
        return values


def advantage_among_alike(advantage: Tensor, alike: int) -> Tensor:
    """Advantages less the mean advantage of the other worlds with the same start, step by step.

    ``A_i - mean_{j != i} A_j``. What a fall costs depends more on how it begins than on what is
    done about it, and a critic learns only a part of that. The actions of the other worlds do not
    depend on those of this one: the mean is a baseline, and the policy gradient stays unbiased.

    Args:
        advantage: ``(N, T, 1)`` of worlds of which ``alike`` in a row began in the same state.
        alike: how many, a divisor of N.

    Source: Kool et al., "Buy 4 REINFORCE samples, get a baseline for free!", ICLR 2019 workshop.
    """
    groups = advantage.unflatten(0, (-1, alike))
    return (groups - groups.mean(1, keepdim=True)).flatten(0, 1) * (alike / (alike - 1))
