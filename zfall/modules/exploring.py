"""A policy that explores by noise which its env keeps."""

from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import ExplorationType
from torchrl.envs.utils import exploration_type
from torchrl.modules import IndependentNormal

from zfall.modules.actors import recurrent_keys


class ExploringActor(TensorDictModuleBase):
    """Acts as an actor does, but with ``exploration_noise`` in place of its own random numbers.

    ``action = mean + deviation * noise``. The probability that it writes is that of each action by
    itself, which PPO's ratio needs. That noise is correlated in time does not enter it.

    Keys: reads what the actor reads and ``exploration_noise`` ``(*B, J)``, of deviation 1; writes
    ``action`` ``(*B, J)`` and ``action_log_prob`` ``(*B,)``.

    Args:
        actor: without memory, of a plain Gaussian.

    Raises:
        ValueError: if it is another one.
    """

    def __init__(self, actor: Any):
        super().__init__()
        kind = actor[-1].distribution_class
        if kind is not IndependentNormal or recurrent_keys(actor):
            what = "a memory" if recurrent_keys(actor) else kind.__name__
            raise ValueError(
                "actor must be a plain Gaussian without memory (components: 0) for an env with "
                f"CorrelatedNoise, got {what}."
            )
        self.actor = actor
        self.in_keys = [*actor.in_keys, "exploration_noise"]
        self.out_keys = ["action", "action_log_prob"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action and its log-probability."""
        if exploration_type() is not ExplorationType.RANDOM:
            return self.actor(tensordict)
        policy = self.actor.get_dist(tensordict.select(*self.actor.in_keys))
        normal = policy.base_dist
        action = normal.loc + normal.scale * tensordict["exploration_noise"]
        tensordict["action"] = action
        return tensordict.set("action_log_prob", policy.log_prob(action))
