"""The config of a training, checked before anything is built from it."""

import math

from omegaconf import DictConfig

from zfall.errors import check_keys, check_number
from zfall.training.checks import check_ranges
from zfall.training.objective import check_loss, target_of

KEYS = {
    *("seed", "num_envs", "groups", "alike", "total_frames", "rollout_steps", "epochs"),
    *("minibatches", "burn_in", "max_grad_norm", "averaging", "resume", "warm_start"),
    *("checkpoint_every", "showcase", "env", "actor", "critic", "loss", "optimizer", "scheduler"),
    *("experiment", "auxiliary_losses", "auxiliary_share", "augmentation"),
}


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
    if cfg.augmentation is not None:
        target_of(cfg.augmentation, "augmentation")
