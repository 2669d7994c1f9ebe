"""Baselines: what a policy is compared with, by name from ``recipes/baseline``.

``_target_`` of such a yaml names a class with what ``Baseline`` says; there is nothing to inherit
and nothing to register.
"""

from typing import Protocol

from hydra.utils import instantiate
from omegaconf import DictConfig

from zfall.configs import compose_config, options_of
from zfall.envs.tables import changed, declaring


class Baseline(Protocol):
    """Acts without an action: by the servos alone, or by transforms of the env's table.

    Attributes:
        servos: whether the servos act at all.
    """

    servos: bool

    def fits(self, env_cfg: DictConfig) -> bool:
        """Whether it can act in this env."""

    def world(self, env_cfg: DictConfig) -> DictConfig:
        """The env's config as this baseline needs it; raises ``ValueError`` if it does not fit."""


class Still:
    """Does nothing: the servos hold the reference pose, or there is no torque at all.

    Args:
        servos: whether they act.
    """

    def __init__(self, *, servos: bool = True):
        self.servos = servos

    def fits(self, env_cfg: DictConfig) -> bool:
        """In every env."""
        return True

    def world(self, env_cfg: DictConfig) -> DictConfig:
        """Without transforms that act by themselves."""
        return passive(env_cfg)


def passive(env_cfg: DictConfig) -> DictConfig:
    """The env's config without transforms whose class declares ``acts_by_itself = True``."""
    active = declaring(env_cfg, "acts_by_itself")
    return changed(env_cfg, [f"transforms.{name}=null" for name in active]) if active else env_cfg


def baseline_names() -> list[str]:
    """All baselines that there are; those that hold still come first."""
    first = ("pose_hold", "limp")
    return sorted(
        options_of("baseline"), key=lambda name: (name not in first, name != first[0], name)
    )


def load_baseline(name: str) -> Baseline:
    """A baseline by its name.

    Raises:
        ValueError: if there is none.
        InstantiationException: if its class does not take what the yaml says.
    """
    if name not in baseline_names():
        raise ValueError(f"baseline must be one of {', '.join(baseline_names())}, got {name!r}.")
    table = compose_config([f"+baseline={name}"], recipe="evaluate").baseline
    baseline: Baseline = instantiate(table)
    return baseline
