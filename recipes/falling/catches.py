"""Looks for movements that catch a fall: ``python -m recipes.falling.catches falls=FILE``.

For each of twelve headings and some ranges of speed, falls that ``recipes.falling.falls`` recorded
after pushes at the torso go on with the joints going through a few postures, without a policy. The
best of many movements are kept and varied (cross-entropy method), each tried on other falls every
time. Good is what comes to rest with torso and head never on the floor, better upright on a knee
or shin, and what lands softly. Goes on from what the robot has, and keeps that where it is better;
takes an hour.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import shown_path
from zfall.errors import SPOKEN
from zfall.values import Count, Name, Positive, Seed, Whole

from ..shell import check_recipe, one_line_errors, start


class Keys(TypedDict):
    """The keys of ``catches.yaml``."""

    falls: Name
    headings: Sequence[Whole]
    speeds: Sequence[Positive]
    until: Sequence[Positive]
    candidates: Count
    trials: Count
    elite: Count
    rounds: Count
    spread: Positive
    seed: Seed


BINS = ("headings", "speeds", "until")
COUNTS = ("candidates", "trials", "elite", "rounds")


@hydra.main(version_base=None, config_path=".", config_name="catches")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``catches.npz``, and prints what comes of each movement on all its falls."""
    with one_line_errors():
        check_recipe(cfg, Keys)
        from rich.console import Console

        from zfall.envs.humanoid import HumanoidEnv
        from zfall.falling.movements import catches_path, load_catches, save_catches
        from zfall.falling.recorded_falls import Falls
        from zfall.falling.search import CrossEntropySearch, check_bins, first_guess, improve

        console = Console()
        search = CrossEntropySearch(
            **{key: cfg[key] for key in COUNTS}, spread=cfg.spread, seed=cfg.seed
        )
        check_bins(cfg.headings, cfg.speeds, cfg.until)
        worlds = search.candidates * search.trials
        env = HumanoidEnv(num_envs=worlds, control_dt=0.04, physics_dt=0.004)
        falls = Falls(env, Path(cfg.falls))
        known = load_catches(env.robot) if catches_path(env.robot).is_file() else None
        catches = first_guess(known, env.stand_position, cfg.until, cfg.speeds)
    path = Path(HydraConfig.get().runtime.output_dir) / "catches.npz"
    save_catches(path, *catches)
    for attempt in improve(catches, falls, search, cfg.headings):
        if attempt.better:
            save_catches(path, *catches)
        console.print(str(attempt), soft_wrap=True)
    console.print(f"wrote {shown_path(path)}", soft_wrap=True)


if __name__ == "__main__":
    start(main)
