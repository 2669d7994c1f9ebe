"""Observations close by, for losses that compare a policy with itself."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import needs_env, normal_for, on_data
from zfall.envs.transforms.observations.vector import vector_spans
from zfall.envs.transforms.values import (
    NOT_NEGATIVE,
    check_not_negative,
    per_world,
    reset_rows,
)
from zfall.values import Keys, NotNegative


class CAPSNeighbours(Transform):
    """Adds to each observation one that is close to it, ``o + sigma * N(0, 1)``.

    For those who want the spatial pairs of CAPS in the data: stands after the observation's
    vector in a table, or in a replay buffer, where it draws anew at every sample
    (``buffer.append_transform``). ``CAPSLoss(neighbour_key=...)`` takes them from there in place of
    drawing its own.

    Keys: reads ``observation`` ``(N, D)``, writes ``observation_neighbour`` ``(N, D)``.

    Args:
        env: the base env, whose streams give the random numbers; ``None``, as a replay buffer
            needs it, for torch's global generator.
        sigma: standard deviation of every component, in the observation's own units; or by name
            of a quantity, which leaves the others as they are.
        keys: quantities of the observation in their order, for a ``sigma`` by name; they are to
            stand in the data next to it.

    Raises:
        ValueError: on a negative sigma, or one that names what is not in ``keys``.

    Source: Mysore et al., "Regularizing action policies for smooth control with reinforcement
    learning", ICRA 2021.
    """

    limits = {"sigma": NOT_NEGATIVE}
    forward = on_data

    def __init__(
        self,
        env: HumanoidEnv | None = None,
        *,
        sigma: NotNegative | Mapping[str, NotNegative],
        keys: Keys | None = None,
    ):
        super().__init__(in_keys=["observation"], out_keys=["observation_neighbour"])
        named = dict(sigma) if isinstance(sigma, Mapping) else {"sigma": sigma}
        check_not_negative("sigma", named)
        unknown = [name for name in named if name not in (keys or [])]
        if isinstance(sigma, Mapping) and unknown:
            raise ValueError(
                f"sigma must name quantities of keys ({', '.join(map(str, keys or []))}), "
                f"got {unknown[0]}."
            )
        self.sigma, self.keys = named, keys or []
        if env is not None:
            needs_env(self, env, "its random numbers")
        self.spans: dict[str, slice] | None = None if isinstance(sigma, Mapping) else {}

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._add(next_tensordict)

    def _add(self, next_tensordict: TensorDictBase, rows: Tensor | None = None) -> TensorDictBase:
        observation: Tensor = next_tensordict["observation"]
        if self.spans is None:
            self.spans = vector_spans(next_tensordict, self.keys)
        noise = normal_for(self, observation, rows)
        if self.spans:
            noise *= self._spread(noise, self.spans)
        else:
            noise *= per_world(self.sigma["sigma"], noise.ndim)
        return next_tensordict.set("observation_neighbour", observation + noise)

    def _spread(self, noise: Tensor, spans: Mapping[str, slice]) -> Tensor:
        """Standard deviation of each component ``(N, D)``; the same in each frame of a stack."""
        size, width = noise.shape[-1], max(span.stop for span in spans.values())
        if size % width:
            raise ValueError(
                f"keys must be all quantities of the observation, or of each frame of a stack: "
                f"they have {width} values, the observation has {size}."
            )
        spread = torch.zeros(*noise.shape[:-1], width)
        for name, value in self.sigma.items():
            spread[..., spans[name]] = per_world(value, noise.ndim)
        return spread.repeat(*[1] * (noise.ndim - 1), size // width)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._add(tensordict_reset, reset_rows(tensordict))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        spec = observation_spec["observation"]
        observation_spec["observation_neighbour"] = Unbounded(spec.shape)
        return observation_spec
