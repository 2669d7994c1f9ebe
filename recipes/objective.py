"""Losses as the config names them: PPO's or a class of one's own, and what else has a target."""

from typing import Any

import torch
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig

from recipes.ranges import LOSS_KEYS
from zfall.losses.ppo import PenalizedPPOLoss


def ppo_loss(cfg: DictConfig, actor: torch.nn.Module, critic: torch.nn.Module) -> PenalizedPPOLoss:
    """The loss of a run.

    Args:
        cfg: the group ``loss``. ``_target_``, if it is there, names a ``PenalizedPPOLoss`` of
            one's own; keys that are not of ``LOSS_KEYS`` go to it.
        actor, critic: the networks that it trains.

    Raises:
        ValueError: if ``_target_`` names something else, or a class with parameters beside the
            networks', which nothing would train.
    """
    target = target_of(cfg, "loss") if "_target_" in cfg else PenalizedPPOLoss
    if not (isinstance(target, type) and issubclass(target, PenalizedPPOLoss)):
        raise ValueError(
            "loss._target_ must name a class that is a zfall.losses.ppo.PenalizedPPOLoss, "
            f"got {cfg['_target_']}."
        )
    own = {key: value for key, value in cfg.items() if key not in LOSS_KEYS | {"_target_"}}
    loss = instantiate(
        {"_target_": target, **own},
        actor,
        critic,
        clip_epsilon=cfg.clip_epsilon,
        critic_coeff=cfg.critic_coeff,
        entropy_coeff=cfg.entropy_coeff,
        entropy_bonus=cfg.entropy_coeff > 0,  # a coefficient of 0 would still compute it
        loss_critic_type="l2",
        normalize_advantage=cfg.normalize_advantage == "minibatch",
        kl_coeff=cfg.kl_coeff,
        kl_target=cfg.kl_target,
        value_clip=cfg.value_clip,
        value_error_clip=cfg.value_error_clip,
    )
    known = {id(weight) for network in (actor, critic) for weight in network.parameters()}
    more = [name for name, weight in loss.named_parameters() if id(weight) not in known]
    if more:
        raise ValueError(
            "loss must have no parameters but the actor's and the critic's, nothing would train "
            f"or save its {more[0]}."
        )
    loss.set_keys(sample_log_prob="action_log_prob")
    return loss


def target_of(config: Any, place: str) -> Any:
    """What the ``_target_`` of a table names.

    Raises:
        ValueError: if it is no table, or names nothing that Python can import.
    """
    target = config.get("_target_") if isinstance(config, DictConfig) else None
    if not isinstance(target, str):
        raise ValueError(
            f"{place} must be a table whose _target_ is the dotted path of a class, got {config}."
        )
    try:
        return get_object(target)
    except ImportError as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise ValueError(
            f"{place}._target_ must name something that Python can import, got {target}: {reason}."
        ) from None
