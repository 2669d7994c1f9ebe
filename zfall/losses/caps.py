"""Smoothness of a policy: conditioning for action policy smoothness (CAPS)."""

import math
from collections.abc import Mapping
from typing import Annotated, Any

import torch
from tensordict import TensorDict, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.modules import ProbabilisticActor, set_recurrent_mode
from torchrl.objectives import LossModule

from zfall.modules.actors import normalizer_of, recurrent_keys
from zfall.modules.gru import borrow_memory
from zfall.modules.memory import lends_memory, memory_before
from zfall.values import NotNegative, one_of

NORMS = {
    "l1": lambda x: x.abs().sum(-1),
    "l2": lambda x: x.square().sum(-1).clamp_min(1e-12).sqrt(),  # of a finite slope at 0
    "squared_l2": lambda x: x.square().sum(-1),
}


class CAPSLoss(LossModule):
    """Penalises actions that change from step to step, or with a small change of what is seen.

    With mu the action without exploration (the statistic the policy is run with), in units of
    the action, and sigma in units of the normalised observation::

        loss_temporal = temporal_coeff * mean_t |mu(o_t) - mu(o_t+1)|
        loss_spatial  = spatial_coeff * mean_t |mu(o_t) - mu(o_t + e)|,   e ~ N(0, sigma^2)

    The gradient with respect to the policy's standard deviation is zero, unless ``on_actions``, or
    for the mode of a mixture, which moves with it.

    Of a policy without memory the pairs are an observation and its successor, which at an
    episode's end is the last one of that episode. Of a recurrent one a batch holds sequences:
    the temporal pair follows them with the memory that they build up, and pairs across an
    episode's end are left out; both of the spatial pair have that memory. With a ``spatial_coeff``
    of 0 no neighbour is drawn, asked or needed in the batch.

    Keys: reads the actor's ``in_keys``, ``(B, ...)``, and ``("next", "observation")`` of a policy
    without memory; ``(N, T, ...)`` of a recurrent one. mu(o) is taken from
    ``deterministic_action`` if the batch has it, of a recurrent policy if it has mu(o + e) too,
    ``neighbour_action``. Writes ``loss_temporal`` and ``loss_spatial`` ``()``.

    Args:
        actor_network: the policy.
        spans: where each quantity lies in the observation, by name, as slices or places; for a
            ``sigma`` by name.
        temporal_coeff, spatial_coeff: weights.
        sigma: standard deviation of the spatial change, in standard deviations of the observation
            (those of the policy's normaliser, or 1); or of each quantity by its name, which
            leaves those that are not named as they are.
        temporal_norm, spatial_norm: ``l1``, ``l2`` or ``squared_l2``.
        on_actions: whether mu is a draw from the policy instead.
        neighbour_key: where the batch holds the changed observation, from ``CAPSNeighbours`` for
            instance; ``None``: it is drawn here.

    Raises:
        ValueError: on a negative value, an unknown norm or name, or actions of a policy that has
            no reparameterised draw.

    Source: Mysore et al., "Regularizing action policies for smooth control with reinforcement
    learning", ICRA 2021 (actions, L2); Duburcq et al., "Reactive stepping for humanoid robots
    using reinforcement learning", IROS 2022, section IV-E (mean, L1 in time and squared L2 in
    space), whose weights and sigma are not published.
    """

    companion_key = "neighbour_action"
    actor_network: ProbabilisticActor
    out_keys = ["loss_temporal", "loss_spatial"]

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        spans: Mapping[str, slice | Tensor] | None = None,
        *,
        temporal_coeff: NotNegative = 0.1,
        spatial_coeff: NotNegative = 0.1,
        sigma: NotNegative | Mapping[str, NotNegative] = 0.2,
        temporal_norm: Annotated[str, one_of(*NORMS)] = "l1",
        spatial_norm: Annotated[str, one_of(*NORMS)] = "squared_l2",
        on_actions: bool = False,
        neighbour_key: str | None = None,
    ):
        super().__init__()
        values = sigma.values() if isinstance(sigma, Mapping) else [sigma]
        weights = {"temporal_coeff": temporal_coeff, "spatial_coeff": spatial_coeff}
        for name, value in [*weights.items(), *(("sigma", value) for value in values)]:
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {value}.")
        for name, norm in (("temporal_norm", temporal_norm), ("spatial_norm", spatial_norm)):
            if norm not in NORMS:
                raise ValueError(f"{name} must be one of {', '.join(NORMS)}, got {norm!r}.")
        if on_actions and not actor_network[-1].distribution_class.has_rsample:
            raise ValueError(
                "on_actions must be false for a mixture, whose draws have no gradient by the "
                "weights of its components; got true."
            )
        self.actor_network, self.on_actions = actor_network, on_actions
        self.temporal_coeff, self.spatial_coeff = temporal_coeff, spatial_coeff
        self.temporal_norm, self.spatial_norm = NORMS[temporal_norm], NORMS[spatial_norm]
        self.recurrent = bool(recurrent_keys(actor_network))
        self._actor_lends = lends_memory(actor_network)
        self.in_keys = list(actor_network.in_keys)
        if not self.recurrent:
            self.in_keys += [unravel_key(("next", key)) for key in actor_network.in_keys]
        self.neighbour_key = neighbour_key if spatial_coeff else None
        if self.neighbour_key is not None:
            self.in_keys.append(self.neighbour_key)
        self.normalizer = normalizer_of(actor_network)
        self.sigma = _spread(sigma, spans or {})

    @classmethod
    def for_task(cls, actor_network: ProbabilisticActor, task: Any, **values: Any) -> "CAPSLoss":
        """With the ``spans`` of the task's observation, see ``zfall.training.task_facts``."""
        return cls(actor_network, task.spans("observation"), **values)

    def companions(self, tensordict: TensorDictBase) -> TensorDictBase | None:
        """The neighbours, seen with the memory of each step, for their ``neighbour_action``.

        ``None`` if they are asked here: without such a memory, or for draws.
        """
        if self.on_actions or not self._actor_lends or not self.spatial_coeff:
            return None
        near = tensordict.select(*self.actor_network.in_keys)
        near["observation"] = self._neighbour(tensordict)
        return borrow_memory(near)

    def counts(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Pairs of which ``loss_temporal`` of sequences is the mean."""
        if not self.recurrent:
            return {}
        return {"loss_temporal": (~tensordict["is_init"][:, 1:, 0]).sum()}

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Both losses of a batch."""
        mu = None if self.on_actions else tensordict.get("deterministic_action", None)
        near: Tensor | None
        if self.recurrent:
            near = tensordict.get(self.companion_key, None)
            if mu is None or (near is None and self.spatial_coeff):
                mu, near = self._sequences(tensordict)
            follows = ~tensordict["is_init"][:, 1:, 0]
            change = self.temporal_norm(mu[:, 1:] - mu[:, :-1]) * follows
            temporal = change.sum() / follows.sum().clamp_min(1)
        else:
            now = tensordict.select(*self.actor_network.in_keys)
            seen = [tensordict["next"].select(*self.actor_network.in_keys)]
            if self.spatial_coeff:
                seen.append(now.copy().set("observation", self._neighbour(tensordict)))
            seen += [now] if mu is None else []
            after, *others = self._act(torch.stack(seen))
            near = others[0] if self.spatial_coeff else None
            mu = others[-1] if mu is None else mu
            temporal = self.temporal_norm(mu - after).mean()
        spatial = mu.new_zeros(()) if near is None else self.spatial_norm(mu - near).mean()
        return TensorDict(
            {
                "loss_temporal": self.temporal_coeff * temporal,
                "loss_spatial": self.spatial_coeff * spatial,
            }
        )

    def _sequences(self, batch: TensorDictBase) -> tuple[Tensor, Tensor | None]:
        """mu of the batch, and of neighbours with the same memory, each ``(N, T, J)``."""
        seen = batch.select(*self.actor_network.in_keys)
        near = seen.copy()
        with set_recurrent_mode(True):
            mu = self._act(seen)
        if not self.spatial_coeff:
            return mu, None
        near["observation"] = self._neighbour(batch)
        near.update(memory_before(self.actor_network, batch, passed=seen))
        with set_recurrent_mode(False):
            return mu, self._act(near.reshape(-1)).view_as(mu)

    def _act(self, batch: TensorDictBase) -> Tensor:
        """mu; the batch then holds all that the policy wrote."""
        distribution = self.actor_network.get_dist(batch)
        if self.on_actions:
            return distribution.rsample()
        return distribution.deterministic_sample

    def _neighbour(self, batch: TensorDictBase) -> Tensor:
        if self.neighbour_key is not None:
            return batch[self.neighbour_key]
        observation = batch["observation"]
        noise = torch.randn_like(observation) * self.sigma.to(observation.device)
        return observation + (noise if self.normalizer is None else noise * self.normalizer.scale)


def _spread(sigma: float | Mapping[str, float], spans: Mapping[str, slice | Tensor]) -> Tensor:
    """Standard deviation of each component of the observation ``(D,)``, or one for all ``()``."""
    if not isinstance(sigma, Mapping):
        return torch.tensor(float(sigma))
    unknown = [name for name in sigma if name not in spans]
    if unknown:
        raise ValueError(
            f"sigma must name quantities of the observation ({', '.join(spans)}), got {unknown[0]}."
        )
    ends = [x.stop if isinstance(x, slice) else int(x.max()) + 1 for x in spans.values()]
    spread = torch.zeros(max(ends))
    for name, value in sigma.items():
        spread[spans[name]] = value
    return spread
