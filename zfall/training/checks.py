"""The config of a training and its env, checked before anything is built from them."""

import math
from collections.abc import Mapping
from typing import Any

from omegaconf import DictConfig, OmegaConf
from torch import Tensor
from torchrl.envs import TransformedEnv

from zfall.complaints import check_table
from zfall.configs import compose_config, plain_containers
from zfall.errors import check_keys, check_number
from zfall.static_checks import check_nodes
from zfall.training.collection import group_sizes
from zfall.training.keys import TrainKeys
from zfall.training.losses import check_loss, target_of
from zfall.training.optimizers import without_fused

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
        check_keys(OmegaConf.create(dict(config)), set(TrainKeys.__annotations__))
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
    check_ranges(cfg)
    for name, loss in cfg.auxiliary_losses.items():
        if loss is not None:
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
    plain = plain_containers(cfg)
    check_table(plain, TrainKeys)
    check_loss(cfg.loss)
    nodes = plain | {"optimizer": without_fused(plain["optimizer"])}
    check_nodes({key: value for key, value in nodes.items() if key != "loss"})
    for size in group_sizes(cfg.num_envs, cfg.groups):
        if size % cfg.alike:
            raise ValueError(
                f"alike must divide the {size} worlds of each group (num_envs, groups), "
                f"got {cfg.alike}."
            )
    own = OmegaConf.select(cfg, "env.base_env.num_envs")
    if own is not None and own != cfg.num_envs:
        raise ValueError(f"env.base_env.num_envs must be left to num_envs, got {own}.")
    if not cfg.burn_in < cfg.rollout_steps:
        raise ValueError(
            f"burn_in must lie in [0, rollout_steps), {cfg.rollout_steps}, got {cfg.burn_in}."
        )
    if "lr" in cfg.optimizer:  # torch takes tensors as well, so that its annotation says little
        rule = "be a number, finite and not negative"
        check_number(cfg.optimizer.lr, "optimizer.lr", lambda x: 0 <= x < math.inf, rule)
        low, high = ((cfg.scheduler or {}).get(key) for key in ("min_lr", "max_lr"))
        both = all(isinstance(bound, int | float) for bound in (low, high))
        if both and not low <= cfg.optimizer.lr <= high:
            raise ValueError(
                f"optimizer.lr must lie within scheduler.min_lr {low} and scheduler.max_lr {high}, "
                f"which would replace it, got {cfg.optimizer.lr}; scheduler=null keeps it fixed."
            )


def check_finite(values: dict[str, Tensor], update: int) -> None:
    """Refuses losses, and what of them is called so, that are no numbers.

    Raises:
        ValueError: naming the first.
    """
    for key, value in values.items():
        if key.startswith(("loss", "gradient")) and not math.isfinite(value):
            raise ValueError(
                f"{key} must stay finite, got {value.item()} in update {update}; checkpoints "
                "written before are sound."
            )
