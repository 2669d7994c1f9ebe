"""Learning from a teacher what to do in the states that the policy itself comes into."""

import math
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor, set_recurrent_mode
from torchrl.objectives import LossModule

from zfall.modules.actors import recurrent_keys
from zfall.values import Name, NotNegative, Positive


class ImitationLoss(LossModule):
    """Draws the policy's action without exploration towards that of a trained policy.

    With mu the former and mu_T the latter ``(J,)``, in units of the action::

        loss_imitation = coeff * mean_t |mu(o_t) - mu_T(o_t)|^2 / (2 std^2)

    which is the KL divergence of two Gaussians of the same deviation ``std``. The teacher tells of
    every state that the policy visits, so that errors do not add up as in copies of recorded
    motions; beside PPO's loss it gives a policy a start that it may then surpass. Only the mean
    is taught: how much the policy explores is up to it.

    Keys: reads the actor's ``in_keys``, ``(B, ...)``, ``(N, T, ...)`` of a recurrent one, and
    ``deterministic_action`` in the place of mu if the batch has it, and ``sees``; writes
    ``loss_imitation`` ``()``.

    Args:
        actor_network: the policy.
        teacher: a policy without memory that reads ``observation`` alone; it stays as it is.
        sees: where the batch has what the teacher is shown, ``observation`` or, of a teacher that
            sees more than the policy, another vector: ``observation_critic``.
        coeff: weight.
        std: deviation for which two actions count as equal, in units of the action.

    Raises:
        ValueError: on a weight below 0, a deviation that is not positive, or a teacher that has a
            memory or reads more than one vector.

    Source: Ross et al., "A reduction of imitation learning and structured prediction to no-regret
    online learning", AISTATS 2011; beside a policy gradient: Schmitt et al., "Kickstarting deep
    reinforcement learning", 2018.
    """

    actor_network: ProbabilisticActor
    out_keys = ["loss_imitation"]

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        teacher: TensorDictModuleBase,
        *,
        coeff: NotNegative = 1.0,
        std: Positive = 0.1,
        sees: Name = "observation",
    ):
        super().__init__()
        if not 0 <= coeff < math.inf:
            raise ValueError(f"coeff must be finite and not negative, got {coeff}.")
        if not 0 < std < math.inf:
            raise ValueError(f"std must be finite and positive, got {std}.")
        if recurrent_keys(teacher):
            raise ValueError("teacher must be a policy without memory, got a recurrent one.")
        if more := [key for key in teacher.in_keys if key != "observation"]:
            raise ValueError(f"teacher must see the observation alone, this one sees {more[0]}.")
        self.actor_network, self.sees = actor_network, sees
        self.in_keys = list(dict.fromkeys([*actor_network.in_keys, sees]))
        self.weight = coeff / (2.0 * std**2)
        self._teacher: list[Any] = [teacher]  # in a list its weights are none of this module's

    @classmethod
    def for_task(
        cls,
        actor_network: ProbabilisticActor,
        task: Any,
        *,
        teacher: Name,
        sees: Name = "observation",
        **values: Any,
    ) -> "ImitationLoss":
        """With the policy of a run, or one that ships, by its name as the teacher."""
        return cls(actor_network, task.policy(teacher, sees), sees=sees, **values)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The loss of a batch."""
        mu = tensordict.get("deterministic_action", None)
        if mu is None:
            with set_recurrent_mode(True):
                seen = tensordict.select(*self.actor_network.in_keys)
                mu = self.actor_network.get_dist(seen).deterministic_sample
        shown = TensorDict({"observation": tensordict[self.sees]}, tensordict.shape)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            target = self._teacher[0].to(mu.device)(shown)["action"]
        error = (mu - target).square().sum(-1).mean()
        return TensorDict({"loss_imitation": self.weight * error})
