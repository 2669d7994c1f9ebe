"""Looks for movements that catch a fall: ``python -m recipes.falling.catches falls=FILE``.

For each of twelve headings and some ranges of speed, falls that ``recipes.falling.falls`` recorded
after pushes at the torso go on with the joints going through a few postures, without a policy. The
best of many movements are kept and varied (cross-entropy method), each tried on other falls every
time. Good is what comes to rest with torso and head never on the floor, better upright on a knee
or shin, and what lands softly. Goes on from what the robot has, and keeps that where it is better;
takes an hour; with ``launcher=ray`` each heading is searched on another node.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import shown_path
from zfall.errors import SPOKEN
from zfall.values import Count, Name, Positive, Seed, Whole

from ..shell import check_recipe, one_line_errors, start

if TYPE_CHECKING:
    from zfall.falling.movements import Catches
    from zfall.robots import Robot

OUTCOMES = "outcomes.txt"  # what came of each search, written once all are over


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
    launcher: Name
    launch: Mapping[Name, Any] | None


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
    folder = Path(HydraConfig.get().runtime.output_dir)
    path, lines = folder / "catches.npz", list[str]()
    save_catches(path, *catches)
    with one_line_errors(SPOKEN):
        if cfg.launcher != "basic":
            lines = search_apart(cfg, folder / "headings", catches, env.robot)
            save_catches(path, *catches)
    for attempt in improve(catches, falls, search, cfg.headings) if not lines else ():
        if attempt.better:
            save_catches(path, *catches)
        lines.append(str(attempt))
        console.print(lines[-1], soft_wrap=True)
    (folder / OUTCOMES).write_text("".join(f"{line}\n" for line in lines))
    console.print(f"wrote {shown_path(path)}", soft_wrap=True)


def search_apart(cfg: DictConfig, parts: Path, catches: "Catches", robot: "Robot") -> list[str]:
    """Has a launcher search each heading by itself, and puts together what was found.

    Returns:
        What came of them. What was found before in the same folder is not searched again.

    Raises:
        ValueError: if some were not searched.
    """
    from zfall.falling.movements import HEADINGS, load_catches
    from zfall.studies.launch import sweep

    done = {heading: parts / str(heading) / OUTCOMES for heading in cfg.headings}
    more = ["launcher=basic", f"hydra.sweep.dir={parts}", "hydra.sweep.subdir=${headings.0}"]
    where = {"launcher": cfg.launcher, "launch": cfg.launch, "log": parts.with_suffix(".log")}
    if todo := [[heading] for heading, file in done.items() if not file.exists()]:
        sweep("headings", todo, module=f"{__package__}.catches", more=more, **where)
    if left := [heading for heading, file in done.items() if not file.exists()]:
        raise ValueError(f"headings must all be searched, {left} are not; see {where['log']}.")
    for heading, file in done.items():
        found = load_catches(robot, file.with_name("catches.npz"))
        number = HEADINGS.index(heading)
        catches.postures[number] = found.postures[number]
        print(file.read_text(), end="")
    return [line for file in done.values() for line in file.read_text().splitlines()]


if __name__ == "__main__":
    start(main)
