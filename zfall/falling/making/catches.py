"""Makes movements that catch a fall."""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from rich.console import Console

from zfall.falling.banks import PUSH_KEYS, load_bank
from zfall.falling.movements import (
    HEADINGS,
    Catches,
    catches_path,
    load_catches,
    save_catches,
)
from zfall.falling.pushed import check_world_name
from zfall.falling.recorded_falls import Falls, falling_worlds
from zfall.falling.search import CrossEntropySearch, check_bins, first_guess, improve
from zfall.robots import DEFAULT
from zfall.values import Count, Name, Positive, Seed, Whole

OUTCOMES = "outcomes.txt"  # what came of each search, written once all are over
_SO_FAR, _LINES = "so_far.npz", "so_far.txt"  # the same while it goes on


class SearchedCatches:
    """Movements that catch a fall, for each heading and some ranges of speed.

    Falls of a bank go on with the joints going through a few postures, without a policy. The best
    of many movements are kept and varied (cross-entropy method), each tried on other falls every
    time. Good is what comes to rest with torso and head never on the floor, better upright on a
    knee or shin, and what lands softly. Goes on from what the robot has, and keeps that where it
    is better. A search that was cut goes on with the heading at which it was.

    Args:
        falls: file of ``RecordedFalls``, after pushes at the torso.
        world: battery in whose hardware falls go on, ``twin``, each in a draw of its own; ``None``:
            the published servos, and no delays.
        headings: of the falls to catch, left is 90 [degrees].
        speeds: between the ranges of speed of the falls [m/s].
        until: when each posture but the last ends [s].
        candidates: movements of a round.
        trials: falls on which each is tried.
        elite: movements that are kept.
        rounds: for each heading and range of speed.
        spread: of the first round [rad].
        seed: of the search.
    """

    suffix: ClassVar[str] = ".npz"
    is_policy: ClassVar[bool] = False

    def __init__(
        self,
        *,
        falls: Name,
        world: Name | None = None,
        headings: Sequence[Whole] = HEADINGS,
        speeds: Sequence[Positive] = (1.65, 2.15, 2.4),
        until: Sequence[Positive] = (0.08, 0.16, 0.32, 0.6),
        candidates: Count = 256,
        trials: Count = 4,
        elite: Count = 24,
        rounds: Count = 20,
        spread: Positive = 0.5,
        seed: Seed = 0,
    ):
        check_world_name(world)
        self.search = CrossEntropySearch(
            candidates=candidates,
            trials=trials,
            elite=elite,
            rounds=rounds,
            spread=spread,
            seed=seed,
        )
        check_bins(headings, speeds, until)
        self.falls, self.world, self.headings = Path(falls), world, list(headings)
        load_bank(self.falls, DEFAULT, needs=PUSH_KEYS, name="falls")
        self.speeds, self.until = list(speeds), list(until)

    @property
    def first(self) -> Catches:
        """The movements with which the search begins."""
        known = load_catches(DEFAULT) if catches_path(DEFAULT).is_file() else None
        return first_guess(known, DEFAULT.stand_position, self.until, self.speeds)

    def make(self, path: Path, console: Console) -> None:
        """Writes the movements, and ``outcomes.txt`` with what comes of each on all its falls."""
        so_far, told = path.with_name(_SO_FAR), path.with_name(_LINES)
        catches, lines = self.first, list[str]()
        if so_far.is_file() and told.is_file():
            catches, lines = load_catches(DEFAULT, so_far), told.read_text().splitlines()
        worlds = falling_worlds(self.search.candidates * self.search.trials, self.world)
        falls = Falls(worlds, self.falls)
        for attempt in improve(catches, falls, self.search, self.headings, begin=len(lines)):
            lines.append(str(attempt))
            console.print(lines[-1], soft_wrap=True)
            save_catches(so_far, *catches)
            told.write_text("".join(f"{line}\n" for line in lines))
        save_catches(path, *catches)
        path.with_name(OUTCOMES).write_text("".join(f"{line}\n" for line in lines))
        for part in (so_far, told):
            part.unlink(missing_ok=True)

    def stand_in(self, path: Path) -> None:
        """Writes the movements with which the search begins."""
        save_catches(path, *self.first)
