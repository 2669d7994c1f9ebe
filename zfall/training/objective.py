"""Losses as the config names them: PPO's or a class of one's own, and what else has a target."""

import inspect
from typing import Any

import torch
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, open_dict

from zfall.errors import check_keys, not_found
from zfall.losses.ppo import PenalizedPPOLoss

LOSS_KEYS = {
    *("gamma", "lmbda", "clip_epsilon", "critic_coeff", "entropy_coeff"),
    *("normalize_advantage", "kl_stop", "kl_coeff", "kl_target", "value_clip", "value_error_clip"),
}


def ppo_loss(cfg: DictConfig, actor: torch.nn.Module, critic: torch.nn.Module) -> PenalizedPPOLoss:
    """The loss of a run.

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
        ValueError: on a key that nothing reads, or another class.
    """
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
