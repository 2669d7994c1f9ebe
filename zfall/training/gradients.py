"""The size of the gradients that a step of the optimizer sees."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_, get_total_norm

Parts = Mapping[str, Sequence[nn.Parameter]]


def parts_of(actor: nn.Module, critic: nn.Module) -> dict[str, list[nn.Parameter]]:
    """The parameters of the ``actor``, and those of the ``critic`` that are not the actor's."""
    of_actor = list(actor.parameters())
    known = {id(parameter) for parameter in of_actor}
    return {
        "actor": of_actor,
        "critic": [each for each in critic.parameters() if id(each) not in known],
    }


def clip_gradients(parts: Parts, bound: float | Mapping[str, float]) -> dict[str, Tensor]:
    """Cuts gradients to a bound on their norm.

    Args:
        parts: parameters by part.
        bound: of the norm over all parts together, or one for each part by its name. Together, a
            critic whose gradient is large shortens the step of the actor.

    Returns:
        ``gradient/PART``, the norm before the cut ``()``.
    """
    norms = {}
    for name, parameters in parts.items():
        if isinstance(bound, Mapping):
            norms[name] = clip_grad_norm_(parameters, bound[name])
        else:
            norms[name] = get_total_norm([p.grad for p in parameters if p.grad is not None])
    if not isinstance(bound, Mapping):
        clip_grad_norm_([each for part in parts.values() for each in part], bound)
    return {f"gradient/{name}": torch.as_tensor(norm) for name, norm in norms.items()}
