"""One pass of the policy over a batch, and over what its losses want to know of other states."""

from collections.abc import Sequence
from typing import Any

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.modules import ProbabilisticActor, set_recurrent_mode

from zfall.modules.gru import BORROWED, together
from zfall.modules.memory import lends_memory

POLICY = "policy_distribution"  # where a batch keeps the distribution that a pass gave


def policy_pass(
    actor: ProbabilisticActor, batch: TensorDictBase, companions: Sequence[TensorDictBase] = ()
) -> tuple[Any, list[Tensor]]:
    """What the policy does in a batch and in the states that losses add to it.

    A recurrent network takes nearly as long for a few sequences as for many, so that all of them
    go through it at once.

    Args:
        actor: the policy.
        batch: ``(B,)``, or sequences ``(N, T)`` of a recurrent policy.
        companions: further inputs of the actor, each ``(M,)`` or ``(M, T)``. Sequences may borrow
            the memory of the batch's, see ``zfall.modules.gru.borrow_memory``.

    Returns:
        The distribution of the actions in the batch, with its graph; and of each companion the
        actions without exploration ``(M, ..., J)``.

    Raises:
        ValueError: if sequences borrow the memory of an actor that lends none.
    """
    inputs, places = together([batch, *companions], actor.in_keys)
    if BORROWED in inputs.keys() and not lends_memory(actor):
        raise ValueError(
            "companions must have a memory of their own for an actor that lends none, as a "
            "StackedGRU does: zfall.modules.memory.memory_before gives it."
        )
    with set_recurrent_mode(True):
        found = actor.get_dist_params(inputs)
    if not companions:
        return actor.build_dist_from_params(found), []
    policy, *others = (actor.build_dist_from_params(found[place]) for place in places)
    return policy, [other.deterministic_sample for other in others]


def keep_policy(batch: TensorDictBase, policy: Any) -> TensorDictBase:
    """The batch with the distribution of its actions, for a loss to take instead of the actor."""
    return batch.copy().set_non_tensor(POLICY, policy)


def kept_policy(batch: TensorDictBase) -> Any:
    """What ``keep_policy`` put there; ``None`` if nothing."""
    return batch.get_non_tensor(POLICY, None)
