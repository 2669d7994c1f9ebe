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
from omegaconf import DictConfig, OmegaConf

from zfall.commands import shown_path
from zfall.errors import SPOKEN
from zfall.values import Count, Name, Positive, Seed

from ..shell import check_recipe, one_line_errors, start


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
    seed: Seed
    movements: Mapping[Name, Mapping[Name, Any]]


COUNTS = ("candidates", "trials", "elite", "rounds")


@hydra.main(version_base=None, config_path=".", config_name="rises")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``rises.npz``, and prints what comes of each movement on all its starts."""
    with one_line_errors():
        check_recipe(cfg, Keys)
        from zfall.falling.lying import lying_path
        from zfall.falling.rise_search import LyingWorlds, search_rise
        from zfall.falling.rises import load_rises, save_rises, written_rises
        from zfall.falling.search import CrossEntropySearch
        from zfall.robots import DEFAULT

        counts = {key: cfg[key] for key in COUNTS}
        search = CrossEntropySearch(**counts, spread=cfg.spread, seed=cfg.seed)
        table: Any = OmegaConf.to_container(cfg.movements)
        rises = written_rises(DEFAULT, table)
        if cfg.known is not None:
            rises = load_rises(DEFAULT, Path(cfg.known))
        names = rises.names if cfg.searched is None else cfg.searched
        if unknown := [name for name in names if name not in rises.names]:
            raise ValueError(f"searched must be of {', '.join(rises.names)}, got {unknown[0]}.")
        bank = lying_path(DEFAULT) if cfg.bank is None else Path(cfg.bank)
        worlds = LyingWorlds(search.candidates * search.trials, bank, seed=cfg.seed)
    path = Path(HydraConfig.get().runtime.output_dir) / "rises.npz"
    save_rises(path, rises)
    for name in names:
        before, after = search_rise(worlds, rises, name, search)
        save_rises(path, rises)
        shares = [f"{each.reached.float().mean():.2f}" for each in (before, after)]
        scores = [f"{each.score.mean():.2f}" for each in (before, after)]
        print(f"{name}: {' -> '.join(shares)} reach it, score {' -> '.join(scores)}", flush=True)
    print(f"wrote {shown_path(path)}")


if __name__ == "__main__":
    start(main)
