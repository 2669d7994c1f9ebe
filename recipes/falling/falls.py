"""Records falls, in whose midst trainings begin: ``python -m recipes.falling.falls run=best``.

A policy is pushed from all sides at some points by more than it withstands; pushes begin in any
physics step. Of every trial that ends on the floor the states nearest to some ``times`` after the
push began are kept, when a trigger may first give up: a fall takes 0.3 s. With ``times=null``, for
a policy that kneels, it is the state at its own trigger, of all trials.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Count, Name, Names, NotNegative, Positive, Rule, Seed

from ..shell import Changes, Checkpoint, Run, check_recipe, one_line_errors, start
from .made import make_one


class Keys(TypedDict):
    """The keys of ``falls.yaml``."""

    run: Run
    checkpoint: Checkpoint
    trust: Changes
    change: Changes
    world: Name | None
    seed: Seed
    starts: Count
    impulses: Annotated[Sequence[Positive], Rule("hold at least one", lambda x: len(x) > 0)]
    points: Names
    duration: Positive
    times: Annotated[Sequence[NotNegative], Rule("hold at least one", lambda x: len(x) > 0)] | None


@hydra.main(version_base=None, config_path=".", config_name="falls")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``falls.npz``, see ``zfall.falling.banks.load_bank``."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    with trusting(cfg.trust):
        make_one("RecordedFalls", cfg, Path(HydraConfig.get().runtime.output_dir) / "falls.npz")


if __name__ == "__main__":
    start(main)
