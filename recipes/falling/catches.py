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
from .made import make_one, maker_of

if TYPE_CHECKING:
    from zfall.falling.movements import Catches

OUTCOMES = "outcomes.txt"  # what came of each search, written once all are over
APART = ("launcher", "launch")  # keys of the recipe alone


class Keys(TypedDict):
    """The keys of ``catches.yaml``."""

    falls: Name
    world: Name | None
    headings: Sequence[Whole]
    mirrored: bool
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


@hydra.main(version_base=None, config_path=".", config_name="catches")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``catches.npz``, and prints what comes of each movement on all its falls."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    folder = Path(HydraConfig.get().runtime.output_dir)
    if cfg.launcher == "basic":
        make_one("SearchedCatches", cfg, folder / "catches.npz", APART)
        return
    with one_line_errors():
        search_apart(cfg, folder, maker_of("SearchedCatches", cfg, APART).first)


def search_apart(cfg: DictConfig, folder: Path, catches: "Catches") -> None:
    """Has a launcher search each heading by itself, and puts together what was found.

    What was found before in the same folder is not searched again.

    Raises:
        ValueError: if some were not searched.
    """
    from zfall.falling.movements import HEADINGS, load_catches, save_catches
    from zfall.robots import DEFAULT
    from zfall.studies.launch import sweep

    path, parts = folder / "catches.npz", folder / "headings"
    save_catches(path, *catches)
    done = {heading: parts / str(heading) / OUTCOMES for heading in cfg.headings}
    more = ["launcher=basic", f"hydra.sweep.dir={parts}", "hydra.sweep.subdir=${headings.0}"]
    where = {"launcher": cfg.launcher, "launch": cfg.launch, "log": parts.with_suffix(".log")}
    if todo := [[heading] for heading, file in done.items() if not file.exists()]:
        sweep("headings", todo, module=f"{__package__}.catches", more=more, **where)
    if left := [heading for heading, file in done.items() if not file.exists()]:
        raise ValueError(f"headings must all be searched, {left} are not; see {where['log']}.")
    for heading, file in done.items():
        found = load_catches(DEFAULT, file.with_name("catches.npz"))
        number = HEADINGS.index(heading)
        catches.postures[number] = found.postures[number]
        print(file.read_text(), end="")
    save_catches(path, *catches)
    (folder / OUTCOMES).write_text("".join(file.read_text() for file in done.values()))
    print(f"wrote {shown_path(path)}")


if __name__ == "__main__":
    start(main)
