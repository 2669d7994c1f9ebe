"""The config of a training and its env, checked before anything is built from them."""

import math
from collections.abc import Mapping
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf
from torch import Tensor
from torchrl.envs import TransformedEnv

from zfall.configs import compose_config
from zfall.errors import check_keys, check_number, check_whole
from zfall.training.collection import group_sizes
from zfall.training.losses import check_loss, target_of

KEYS = {
    *("seed", "num_envs", "groups", "alike", "total_frames", "rollout_steps", "epochs"),
    *("minibatches", "burn_in", "max_grad_norm", "averaging", "resume", "warm_start", "name"),
    *("checkpoint_every", "showcase", "env", "actor", "critic", "loss", "optimizer", "scheduler"),
    *("experiment", "auxiliary_losses", "auxiliary_share", "augmentation", "logger"),
    "trust",
}
_COUNTS = ("num_envs", "alike", "rollout_steps", "epochs", "minibatches", "checkpoint_every")
_TABLES = {
    "optimizer": "{_target_: torch.optim.Adam, lr: 5.0e-4}",
    "scheduler": "{_target_: torchrl.objectives.KLAdaptiveLR, ...}, or null",
    "auxiliary_losses": "{NAME: {_target_: ..., ...}}, or {} for none",
}
_WRITTEN_BY = {  # what learning reads of every task
    "action": "zfall.envs.transforms.actions.JointPositionTarget",
    "observation": "zfall.envs.transforms.observations.ObservationVector",
    "reward": "zfall.envs.transforms.rewards.WeightedReward",
    "is_init": "torchrl.envs.InitTracker",
    "episode_reward": "torchrl.envs.RewardSum",
}


def whole_config(config: DictConfig | Mapping[str, Any]) -> DictConfig:
    """The config of a training, its numbers checked.

    Args:
        config: composed from ``recipes/train.yaml``; or a nested dict, of whose top level what is
            missing is the quickstart's.

    Raises:
        ValueError: on a key that nothing reads, or a number out of its range.
    """
    if isinstance(config, DictConfig):
        cfg = config
    else:
        check_keys(OmegaConf.create(dict(config)), KEYS)
        cfg = compose_config()
        OmegaConf.set_struct(cfg, False)
        for key, value in config.items():
            cfg[key] = value
    check_ranges(cfg)
    return cfg


def check_config(cfg: DictConfig) -> None:
    """Refuses a composed config of ``recipes.train``.

    Raises:
        ValueError: on a key that nothing reads, a number out of its range, or a loss or
            augmentation that is no table with the path of something that can be imported.
    """
    check_keys(cfg, KEYS)
    check_number(
        cfg.total_frames, "total_frames", lambda x: 0 < x < math.inf, "be a positive number"
    )
    check_ranges(cfg)
    check_loss(cfg.loss)
    for name, loss in cfg.auxiliary_losses.items():
        target_of(loss, f"auxiliary_losses.{name}")
    for number, logger in enumerate(cfg.logger or ()):
        target_of(logger, f"logger.{number}")
    if cfg.augmentation is not None:
        target_of(cfg.augmentation, "augmentation")


def check_task(env: TransformedEnv, cfg: DictConfig) -> None:
    """Refuses an env that lacks what learning reads, or begins another number of worlds alike.

    A transform that starts several worlds in the same state says how many in a row as ``alike``.

    Raises:
        ValueError: naming the key and a transform that brings it.
    """
    begins = next((t for t in env.transform if hasattr(t, "alike")), None)
    number = getattr(begins, "alike", 1)
    if cfg.alike != number:
        kind, table = type(begins).__name__, OmegaConf.select(cfg, "env.transforms") or {}
        name = next((key for key in table if _class_name(table[key]) == kind), kind)
        here = (
            f"env.transforms.{name}.alike, {number}"
            if begins
            else "1 without a transform that has one"
        )
        raise ValueError(f"alike must be {here}, got {cfg.alike}.")
    specs = (env.observation_spec, env.full_reward_spec, env.full_action_spec)
    there = {key for spec in specs for key in spec.keys()}
    for key, transform in _WRITTEN_BY.items():
        if key not in there:
            raise ValueError(f"env.transforms must bring {key}, as {transform} does.")


def _class_name(transform: Any) -> str:
    target = transform.get("_target_") if isinstance(transform, DictConfig) else None
    return str(target).rpartition(".")[2]


def check_ranges(cfg: DictConfig) -> None:
    """Refuses numbers of ``recipes/train.yaml`` that no training can have.

    Raises:
        ValueError: on a number out of its range, or something else in its place.
    """
    check_whole(cfg, _COUNTS, 1)
    check_whole(cfg, ("seed", "burn_in"))
    if cfg.groups is not None:
        check_whole(cfg, ("groups",), 1)
    for size in group_sizes(cfg.num_envs, cfg.groups):
        if size % cfg.alike:
            raise ValueError(
                f"alike must divide the {size} worlds of each group (num_envs, groups), "
                f"got {cfg.alike}."
            )
    own = OmegaConf.select(cfg, "env.base_env.num_envs")
    if own is not None and own != cfg.num_envs:
        raise ValueError(f"env.base_env.num_envs must be left to num_envs, got {own}.")
    check_number(
        cfg.burn_in, "burn_in", lambda x: 0 <= x < cfg.rollout_steps, "lie in [0, rollout_steps)"
    )
    check_number(cfg.auxiliary_share, "auxiliary_share", lambda x: 0 < x <= 1, "lie in (0, 1]")
    check_number(cfg.averaging, "averaging", lambda x: 0 <= x < 1, "lie in [0, 1)")
    check_number(cfg.max_grad_norm, "max_grad_norm", lambda x: x > 0, "be positive")
    for key, example in _TABLES.items():
        if not (isinstance(cfg[key], DictConfig) or (key == "scheduler" and cfg[key] is None)):
            raise ValueError(f"{key} must be a table, {example}, got {cfg[key]}.")
        if key != "auxiliary_losses" and cfg[key] is not None and "_target_" not in cfg[key]:
            raise ValueError(f"{key} must have a _target_, {example}, got none.")
    if "lr" in cfg.optimizer:
        check_number(cfg.optimizer.lr, "optimizer.lr", lambda x: x >= 0, "be a number, at least 0")
        low, high = ((cfg.scheduler or {}).get(key) for key in ("min_lr", "max_lr"))
        both = all(isinstance(bound, int | float) for bound in (low, high))
        if both and not low <= cfg.optimizer.lr <= high:
            raise ValueError(
                f"optimizer.lr must lie within scheduler.min_lr {low} and scheduler.max_lr {high}, "
                f"which would replace it, got {cfg.optimizer.lr}; scheduler=null keeps it fixed."
            )
    _check_loss(cfg.loss)
    if cfg.showcase is not None:  # said now, not at the end of the training
        _check_showcase(cfg.showcase)


def _check_showcase(showcase: Any) -> None:
    if not isinstance(showcase, DictConfig):
        raise ValueError(
            f"showcase must be a table of sizes, starts and video, or null, got {showcase}."
        )
    check_keys(showcase, {"sizes", "starts", "video"}, "showcase.")
    rule = "be a whole number, at least 1"
    check_number(showcase.starts, "showcase.starts", lambda x: x >= 1 and x % 1 == 0, rule)
    sizes = showcase.sizes
    if not isinstance(sizes, ListConfig) or not sizes:
        raise ValueError(f"showcase.sizes must be a list of at least one size, got {sizes}.")
    for size in sizes:
        check_number(size, "showcase.sizes", lambda x: 0 < x < math.inf, "hold positive sizes")


def _check_loss(loss: DictConfig) -> None:
    for key in ("gamma", "lmbda"):
        check_number(loss[key], f"loss.{key}", lambda x: 0 <= x <= 1, "lie in [0, 1]")
    check_number(loss.clip_epsilon, "loss.clip_epsilon", lambda x: 0 < x <= 1, "lie in (0, 1]")
    for key in ("critic_coeff", "entropy_coeff", "kl_coeff"):
        check_number(loss[key], f"loss.{key}", lambda x: x >= 0, "be a number, at least 0")
    for key in ("kl_stop", "kl_target", "value_clip", "value_error_clip"):
        if loss[key] is not None:
            check_number(loss[key], f"loss.{key}", lambda x: x > 0, "be positive or null")
    if loss.normalize_advantage not in ("minibatch", "batch", None):
        raise ValueError(
            "loss.normalize_advantage must be minibatch, batch or null, "
            f"got {loss.normalize_advantage}."
        )


def check_finite(values: dict[str, Tensor], update: int) -> None:
    """Refuses losses, and what of them is called so, that are no numbers.

    Raises:
        ValueError: naming the first.
    """
    for key, value in values.items():
        if key.startswith("loss") and not math.isfinite(value):
            raise ValueError(
                f"{key} must stay finite, got {value.item()} in update {update}; checkpoints "
                "written before are sound."
            )
