"""Losses beside PPO's and the augmentation, given what they ask for, and what they remember."""

import inspect
from collections.abc import Iterable, Mapping
from typing import Any

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig
from tensordict import unravel_key
from torchrl.envs import TransformedEnv

from zfall.envs.mirror import Mirror, mirror_action, mirror_vector
from zfall.envs.transforms.observations.vector import vector_spans
from zfall.fingerprints import weights_digest
from zfall.policies.load import read_teacher
from zfall.training.objective import target_of


def build(
    config: DictConfig, place: str, env: TransformedEnv, cfg: DictConfig, *args: object
) -> tuple[Any, str | None]:
    """A loss or augmentation, given what it asks for: ``spans``, ``mirrors``, ``teacher``.

    ``spans`` say where each quantity lies in the observation; ``mirrors`` reflect the keys that
    the class names as ``mirrored``; the teacher, a run, is read.

    Args:
        config: what is built, a table with a ``_target_``.
        place: where that stands in the config.
        env: of the training.
        cfg: of the training.
        args: what is handed to it besides.

    Returns:
        It, and the digest of its teacher's weights if it has one.

    Raises:
        ValueError: if there is no such class or teacher, or an observation cannot be mirrored.
    """
    target = target_of(config, place)
    asked = inspect.signature(target).parameters
    known: dict[str, Any] = {}
    digest = None
    if "spans" in asked:
        known["spans"] = _spans(env, "observation")[0]
    if "mirrors" in asked:
        known["mirrors"] = {key: _mirror(env, key) for key in target.mirrored}
    if "teacher" in asked:
        known["teacher"] = read_teacher(config.get("teacher"), cfg, f"{place}.teacher")
        digest = weights_digest(known["teacher"])
    return instantiate(config, *args, **known), digest


def check_reads(modules: Mapping[str, Any], given: Iterable[Any]) -> None:
    """Refuses losses, by their place, that read what is not there.

    Raises:
        ValueError: naming the key.
    """
    given = set(given)
    for place, module in modules.items():
        for key in module.in_keys:
            here = unravel_key(key[1:]) if isinstance(key, tuple) and key[0] == "next" else key
            if here not in given:
                raise ValueError(f"{place} must read what env or networks give, not {key}.")


def check_writes(losses: Mapping[str, Any]) -> None:
    """Refuses losses, by their place, that write one name twice: the first would not be learned.

    Raises:
        ValueError: naming both and what they write.
    """
    writes: dict[str, str] = {}
    for place, loss in losses.items():
        for key in getattr(loss, "out_keys", ()):
            if writes.setdefault(key, place) != place:
                raise ValueError(
                    f"{place} must write under names of its own (out_keys), {key} is written by "
                    f"{writes[key]} already: take one of the two out."
                )


def check_parameters(module: Any, place: str, trained: Iterable[torch.nn.Parameter]) -> None:
    """Refuses parameters that nothing would train or save.

    Raises:
        ValueError: naming the first.
    """
    known = {parameter.data_ptr() for parameter in trained}
    own = [name for name, value in module.named_parameters() if value.data_ptr() not in known]
    if own:
        raise ValueError(
            f"{place} must have no parameters but the actor's and the critic's, nothing would "
            f"train or save its {own[0]}."
        )


def buffers_of(
    modules: Mapping[str, Any], networks: Iterable[torch.nn.Module]
) -> dict[str, torch.Tensor]:
    """What losses and the augmentation remember, by place; the networks' own buffers left out."""
    # A loss holds those of the networks too, under other names.
    known = {buffer.data_ptr() for network in networks for buffer in network.buffers()}
    return {
        f"{place}.{name}": buffer
        for place, module in modules.items()
        if isinstance(module, torch.nn.Module)
        for name, buffer in module.named_buffers()
        if buffer.data_ptr() not in known
    }


def _spans(env: TransformedEnv, key: str) -> tuple[dict[str, slice], Any]:
    """Where quantities lie in an observation, and the transform that lines them up."""
    vectors = [t for t in env.transform if t.out_keys == [key] and hasattr(t, "keys")]
    if not vectors:
        return {}, None
    return vector_spans(env.observation_spec, vectors[-1].keys), vectors[-1]


def _mirror(env: TransformedEnv, key: str) -> Mirror:
    base = env.base_env
    if key == "action":
        return mirror_action(base.robot, env.action_spec.shape[-1])
    spans, vector = _spans(env, key)
    size = env.observation_spec[key].shape[-1]
    if max((span.stop for span in spans.values()), default=0) != size:
        raise ValueError(f"a mirrored {key} must be one vector of quantities, got {size} values.")
    return mirror_vector(base.robot, spans, base.joint_range, getattr(vector, "affine", None))
