"""Makes movements that catch a fall."""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from rich.console import Console

from zfall.falling.bank_worlds import BankWorlds
from zfall.falling.banks import PUSH_KEYS, bank_control_dt, load_bank
from zfall.falling.making.progress import Progress
from zfall.falling.movements import (
    HEADINGS,
    Catches,
    catches_path,
    load_catches,
    save_catches,
)
from zfall.falling.pushed import check_world_name
from zfall.falling.recorded_falls import Falls
from zfall.falling.search import CrossEntropySearch, check_bins, first_guess, improve
from zfall.robots import DEFAULT
from zfall.values import Count, Name, Positive, Seed, Whole

OUTCOMES = "outcomes.txt"  # what came of each search, written once all are over


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
        mirrored: whether falls to the left are caught by the image of a movement for the right, as
            with ``MirroredFalls``: those are searched on both, and none for the left.
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
        mirrored: bool = False,
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
        self.falls, self.world, self.mirrored = Path(falls), world, mirrored
        self.headings = [each for each in headings if not (mirrored and 0 < each < 180)]
        load_bank(self.falls, DEFAULT, needs=PUSH_KEYS, name="falls")
        self.speeds, self.until = list(speeds), list(until)

    @property
    def first(self) -> Catches:
        """The movements with which the search begins."""
        known = load_catches(DEFAULT) if catches_path(DEFAULT).is_file() else None
        return first_guess(known, DEFAULT.stand_position, self.until, self.speeds)

    def make(self, path: Path, console: Console) -> None:
        """Writes the movements, and ``outcomes.txt`` with what comes of each on all its falls."""
        progress, catches = Progress(path.parent), self.first
        if progress.found is not None:
            catches = load_catches(DEFAULT, progress.found)
        count = self.search.candidates * self.search.trials
        control_dt = bank_control_dt(self.falls, name="falls")
        worlds = BankWorlds(count, self.world, control_dt=control_dt)
        falls = Falls(worlds, self.falls, mirrored=self.mirrored)
        begin = len(progress.lines)
        for attempt in improve(catches, falls, self.search, self.headings, begin=begin):
            console.print(str(attempt), soft_wrap=True)
            progress.add(str(attempt), lambda file: save_catches(file, *catches))
        save_catches(path, *catches)
        progress.end(path.with_name(OUTCOMES))

    def stand_in(self, path: Path) -> None:
        """Writes the movements with which the search begins."""
        save_catches(path, *self.first)
