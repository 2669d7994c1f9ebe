"""A task as one env: a base env in a table of transforms."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv

from zfall.envs.env_state import State, env_state, load_env_state


class TableEnv(TransformedEnv):
    """What ``make_env`` builds: TorchRL's ``TransformedEnv``, with two things in addition.

    ``state_dict`` holds all that the env depends on, the physics and the random generator, too. A
    new env that loads it goes on bit for bit, from the same TensorDict.

    Nothing that is not finite leaves it. A world in which a step gives such a value, or is given
    such an action, ends there: ``diverged``, ``terminated`` and ``done`` are set, and 0 stands
    where the value was, also in the TensorDict that the action came in.

    Raises:
        ValueError: if a reset gives what is not finite.
    """

    # That of TransformedEnv keeps transforms around this env from changing the action.
    rand_action = EnvBase.rand_action

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        after = super()._step(tensordict)
        if not _finite(after):
            _end_worlds(after)
        if after["terminated"].any():
            for key in self.action_keys:
                _clean(tensordict, key)
        return after

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        after = super()._reset(tensordict, **kwargs)
        if not _finite(after):
            key = next(key for key, value in _floats(after).items() if not value.isfinite().all())
            raise ValueError(
                f"a reset must give finite values, got {_shown(after[key])} in {key}: look at what "
                "the table says of starts, noise and randomization."
            )
        return after

    def state_dict(self, *args: Any, **kwargs: Any) -> State:
        """All that the env depends on, see ``env_state``."""
        return env_state(self)

    def load_state_dict(self, state_dict: Mapping[str, Any], *args: Any, **kwargs: Any) -> None:
        """Restores what ``state_dict`` gave.

        Raises:
            ValueError: if it is that of another env.
        """
        load_env_state(self, state_dict)


class Table(Compose):
    """``Compose`` in which what prepares a reset runs in the order of the table, too.

    A transform that looks up keys gets an env of copies of those before it. The copies keep such
    envs that the originals have: built anew in each of them, every ``StepCounter``, ``InitTracker``
    and ``RewardSum`` doubles the time in which a task is made.
    """

    def _reset_env_preprocess(self, tensordict: TensorDictBase) -> TensorDictBase:
        for transform in self.transforms:
            tensordict = transform._reset_env_preprocess(tensordict)
        return tensordict

    def _rebuild_up_to(
        self, final_transform: Transform
    ) -> tuple[TransformedEnv | None, Compose | None]:
        env, copies = super()._rebuild_up_to(final_transform)
        for copy, transform in zip(copies or (), self.transforms, strict=False):
            copy.__dict__["_parent"] = transform.__dict__.get("_parent")
        return env, copies

    def clone(self) -> "Table":
        """A copy, without an env."""
        return type(self)(*(transform.clone() for transform in self.transforms))


class DropSubsteps(Transform):
    """Takes ``substeps`` out once all transforms have read them: rollouts need not store them."""

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        del next_tensordict["substeps"]
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        del observation_spec["substeps"]
        return observation_spec


def _floats(tensordict: TensorDictBase) -> dict[NestedKey, Tensor]:
    """All entries that may be NaN."""
    return {key: value for key, value in tensordict.items(True, True) if value.is_floating_point()}


def _finite(tensordict: TensorDictBase) -> bool:
    """Whether all numbers are finite."""
    values = [v for v in tensordict.values(True, True) if v.is_floating_point()]
    # In few calls, for this is done in every step: a norm is finite only if all values are.
    return math.isfinite(sum(map(float, torch._foreach_norm(values, 2.0)))) or all(
        bool(value.isfinite().all()) for value in values
    )


def _end_worlds(after: TensorDictBase) -> None:
    """Ends the worlds that have values not finite, and puts 0 for these."""
    worlds = torch.zeros(after.batch_size, dtype=torch.bool)
    for key, value in _floats(after).items():
        worlds |= ~value.isfinite().reshape(len(worlds), -1).all(-1)
        _clean(after, key)
    for key in {"diverged", "terminated", "done"} & set(after.keys()):
        after[key] = after[key] | worlds[:, None]


def _clean(tensordict: TensorDictBase, key: NestedKey) -> None:
    """Puts 0 for what is not finite, in a new tensor."""
    value = tensordict.get(key, None)
    if value is not None and value.is_floating_point() and not value.isfinite().all():
        tensordict[key] = torch.nan_to_num(value, 0.0, 0.0, 0.0)


def _shown(value: Tensor) -> float:
    return float(value[~value.isfinite()][0])
