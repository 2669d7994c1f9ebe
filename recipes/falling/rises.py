"""Looks for movements that get up: ``python -m recipes.falling.rises bank=FILE``.

It begins with the movements that ``rises.yaml`` writes down, or with those of ``known``. Of each
the best of many variations are kept and varied again (cross-entropy method), each tried
from a few states of a bank of ``recipes.falling.lying``, each in another draw of the twin. From
the back and the sides it is to roll to the belly; from belly and kneel it is to stand. What is
found is kept where it is better.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.errors import SPOKEN
from zfall.values import Count, Name, Positive, Seed

from ..shell import check_recipe, one_line_errors, start
from .made import make_one


class Keys(TypedDict):
    """The keys of ``rises.yaml``."""

    bank: Name | None
    known: Name | None
    searched: Sequence[Name] | None
    candidates: Count
    trials: Count
    elite: Count
    rounds: Count
    spread: Positive
    pace: Positive
    control_dt: Positive
    seed: Seed
    movements: Mapping[Name, Mapping[Name, Any]]


@hydra.main(version_base=None, config_path=".", config_name="rises")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``rises.npz``, and prints what comes of each movement on all its starts."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    make_one("SearchedRises", cfg, Path(HydraConfig.get().runtime.output_dir) / "rises.npz")


if __name__ == "__main__":
    start(main)
