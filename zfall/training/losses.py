"""The losses and the augmentation that a config names, built and checked.

A class may have a classmethod ``for_task(networks, task, **values)``: it is built by that, and may
ask the ``TaskFacts`` where quantities lie in an observation, how they mirror, or for a trained
policy. All others get the network, or networks, and their values.
"""

import inspect
from collections.abc import Iterable, Mapping
from typing import Any

import torch
from hydra.errors import InstantiationException
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, open_dict
from tensordict import unravel_key

from zfall.complaints import check_table
from zfall.configs import plain_containers
from zfall.errors import check_keys, in_one_line, not_found
from zfall.losses.ppo import PenalizedPPOLoss
from zfall.static_checks import check_nodes
from zfall.training.keys import LossKeys
from zfall.training.task_facts import TaskFacts

LOSS_KEYS = set(LossKeys.__annotations__)

TASK_FACTS = {  # what losses take of the task, and what of ``TaskFacts`` gives it
    "spans": "task.spans(key)",
    "mirrors": "task.mirror(key)",
    "teacher": "task.policy(run, sees)",
    "task": "task",
}


def ppo_loss(cfg: DictConfig, actor: torch.nn.Module, critic: torch.nn.Module) -> PenalizedPPOLoss:
    """PPO's loss of a run.

    Args:
        cfg: the group ``loss``, see ``check_loss``; keys that are not of ``LOSS_KEYS`` go to the
            class as they are.
        actor, critic: the networks that it trains.

    Raises:
        ValueError: on what ``check_loss`` refuses.
    """
    check_loss(cfg)
    values = {
        "clip_epsilon": cfg.clip_epsilon,
        "critic_coeff": cfg.critic_coeff,
        "entropy_coeff": cfg.entropy_coeff,
        "entropy_bonus": cfg.entropy_coeff > 0,  # a coefficient of 0 would still compute it
        "loss_critic_type": "l2",
        "normalize_advantage": cfg.normalize_advantage == "minibatch",
        "kl_coeff": cfg.kl_coeff,
        "kl_target": cfg.kl_target,
        "value_clip": cfg.value_clip,
        "value_error_clip": cfg.value_error_clip,
    }
    own = cfg.copy()  # keeps what it refers to outside of itself
    with open_dict(own):
        for key in LOSS_KEYS:
            del own[key]
        own.setdefault("_target_", f"{PenalizedPPOLoss.__module__}.{PenalizedPPOLoss.__name__}")
    values = {key: value for key, value in values.items() if key not in own}
    loss: PenalizedPPOLoss = instantiate(own, actor, critic, **values)
    loss.set_keys(sample_log_prob="action_log_prob")
    return loss


def check_loss(cfg: DictConfig) -> None:
    """Refuses a group ``loss`` of which no loss can be made.

    ``_target_``, if it is there, names a ``PenalizedPPOLoss`` of one's own. TorchRL's losses take
    whatever they are given: a key must be one that this class or one that it is made from names.

    Raises:
        ValueError: on a key that nothing reads, a bad value, or another class.
    """
    ours = {key: value for key, value in plain_containers(cfg).items() if key in LOSS_KEYS}
    check_table(ours, LossKeys, "loss")
    if "_target_" not in cfg:
        check_keys(cfg, LOSS_KEYS, "loss.")
        return
    target = target_of(cfg, "loss")
    if not (isinstance(target, type) and issubclass(target, PenalizedPPOLoss)):
        raise ValueError(
            "loss._target_ must name a class that is a zfall.losses.ppo.PenalizedPPOLoss, "
            f"got {cfg['_target_']}."
        )
    named = {
        name
        for base in target.__mro__
        if issubclass(base, torch.nn.Module) and "__init__" in vars(base)
        for name, value in inspect.signature(base.__init__).parameters.items()
        if value.kind in (value.POSITIONAL_OR_KEYWORD, value.KEYWORD_ONLY)
    }
    given = {"self", "actor_network", "critic_network"}
    check_keys(cfg, LOSS_KEYS | {"_target_"} | (named - given), "loss.")
    theirs = {key: value for key, value in plain_containers(cfg).items() if key not in LOSS_KEYS}
    check_nodes(theirs, "loss")


def build_loss(config: DictConfig, place: str, networks: Any, task: TaskFacts) -> Any:
    """An auxiliary loss or the augmentation.

    Args:
        config: a table with a ``_target_``.
        place: where that stands in the config, for messages.
        networks: the actor, or all networks: what the class takes first.
        task: what a ``for_task`` of the class may ask.

    Raises:
        ValueError: if there is no such class, or what it asks for is not there.
    """
    target = target_of(config, place)
    if not hasattr(target, "for_task"):
        _check_needs_no_task(config, place, target)
        return instantiate(config, networks)
    own = config.copy()
    with open_dict(own):
        own["_target_"] = f"{config['_target_']}.for_task"
    try:
        return instantiate(own, networks, task.at(place))
    except InstantiationException as error:
        raise ValueError(in_one_line(error)) from error


def _check_needs_no_task(config: DictConfig, place: str, target: Any) -> None:
    """Refuses a class without ``for_task`` that takes what only that can give it."""
    first, *others = inspect.signature(target).parameters.values()
    for value in others:
        given = config.get(value.name)
        missing = value.default is value.empty and value.name not in config
        if value.name in TASK_FACTS and (missing or isinstance(given, str)):
            raise ValueError(
                f"{place} must have a classmethod for_task({first.name}, task, **values) in "
                f"{config['_target_']}, which takes {value.name}: {TASK_FACTS[value.name]} gives "
                f"it; got none."
            )


def target_of(config: Any, place: str) -> Any:
    """What the ``_target_`` of a table names.

    Raises:
        ValueError: if it is no table, or names nothing that Python can import and call.
    """
    if not isinstance(config, DictConfig):
        raise ValueError(
            f"{place} must be a table whose _target_ is the dotted path of a class, got {config}."
        )
    target = config.get("_target_")
    if not isinstance(target, str):
        raise ValueError(f"{place}._target_ must be the dotted path of a class, got {target}.")
    if config.get("_partial_"):
        raise ValueError(f"{place} must be built when training begins: take its _partial_ out.")
    try:
        found = get_object(target)
        if not callable(found):
            raise ValueError("it cannot be called")
        return found
    except (ImportError, ValueError) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise ValueError(f"{place}._target_ {not_found(target, reason)}") from None


def check_losses(losses: Mapping[str, Any], trained: Iterable[torch.nn.Parameter]) -> None:
    """Refuses losses, by their place, with parameters or names that would go unseen.

    Raises:
        ValueError: on a parameter that nothing would train or save, a loss that does not say what
            it reads, or one name that two write: the first would not be learned.
    """
    known = {parameter.data_ptr() for parameter in trained}
    writes: dict[str, str] = {}
    for place, loss in losses.items():
        own = [name for name, value in loss.named_parameters() if value.data_ptr() not in known]
        if own:
            raise ValueError(
                f"{place} must have no parameters but the actor's and the critic's, nothing would "
                f"train or save its {own[0]}."
            )
        if not hasattr(loss, "in_keys"):
            raise ValueError(f"{place} must have in_keys, what it reads of a minibatch; got none.")
        for key in getattr(loss, "out_keys", ()):
            if writes.setdefault(key, place) != place:
                raise ValueError(
                    f"{place} must write under names of its own (out_keys), {key} is written by "
                    f"{writes[key]} already: take one of the two out."
                )


def check_networks(networks: Mapping[str, Any], given: Iterable[Any]) -> None:
    """Refuses networks, by their place, that read what is not there.

    Raises:
        ValueError: naming the key; a hidden state without a successor is one.
    """
    given = set(given)
    for place, network in networks.items():
        for key in network.in_keys:
            if key not in given:
                raise ValueError(
                    f"{place} must read what the env gives, not {key}; of a hidden state it must "
                    f"write the successor, under {unravel_key(('next', key))} in its out_keys."
                )


def check_reads(losses: Mapping[str, Any], given: Iterable[Any]) -> None:
    """Refuses losses, by their place, that read what is not there.

    Raises:
        ValueError: naming the key.
    """
    given = set(given)
    for place, loss in losses.items():
        for key in loss.in_keys:
            here = unravel_key(key[1:]) if isinstance(key, tuple) and key[0] == "next" else key
            if here not in given:
                raise ValueError(f"{place} must read what env or networks give, not {key}.")


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
