"""Learns when a fall can no longer be avoided: ``python -m recipes.falling.trigger run=best``.

A policy is pushed, sensors are noisy, and every trial is labelled by its end. A ``FallNetwork``
learns from the measurements, is calibrated on other trials and compared on a third part with the
fixed rule: how early it is, and how often it gives up what would have been recovered.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Count, Name, Names, Positive, Rule, Seed

from ..shell import Changes, Checkpoint, Run, check_recipe, one_line_errors, start
from .made import make_one


class Keys(TypedDict):
    """The keys of ``trigger.yaml``."""

    run: Run
    checkpoint: Checkpoint
    trust: Changes
    change: Changes
    keep: Changes | None
    world: Name | None
    seed: Seed
    measured: Names
    hidden_size: Count
    epochs: Count
    starts: Count
    impulses: Annotated[Sequence[Positive], Rule("hold at least one", lambda x: len(x) > 0)]


@hydra.main(version_base=None, config_path=".", config_name="trigger")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``fall_network.pt``, ``trigger.csv``, ``trigger.md``, ``reliability.csv``, figures."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, Keys)
    with trusting(cfg.trust):
        make_one("TrainedTrigger", cfg, folder / "fall_network.pt")


if __name__ == "__main__":
    start(main)
