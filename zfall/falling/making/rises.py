"""Makes movements that get up."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from rich.console import Console

from zfall.errors import check_number
from zfall.falling.lying import load_lying, lying_path
from zfall.falling.making.progress import Progress
from zfall.falling.rise_search import LyingWorlds, search_rise
from zfall.falling.rises import Rises, load_rises, save_rises, written_rises
from zfall.falling.search import CrossEntropySearch
from zfall.robots import DEFAULT
from zfall.values import Count, Name, Positive, Seed

OUTCOMES = "outcomes.txt"  # what came of each search


class SearchedRises:
    """Movements that get up, searched in the twin by the cross-entropy method.

    Of each the best of many variations are kept and varied again, each tried from a few states of
    a bank, each in another draw of the twin. From the back and the sides it is to roll to the
    belly; from belly and kneel it is to stand. What is found is kept where it is better. A search
    that was cut goes on with the movement at which it was.

    Args:
        bank: starts, of ``LyingStates``; ``None``: those that ship.
        known: file of movements to go on from; ``None``: ``movements``.
        movements: as ``written_rises`` takes them; ``None``: the robot's own that ship.
        searched: names of the movements that are searched; ``None``: all.
        candidates: movements of a round.
        trials: starts from which each is tried.
        elite: movements that are kept.
        rounds: for each movement.
        spread: of the first round [rad].
        pace: time of those that are searched, as a share of that which they are known with.
        control_dt: of the policy that rises [s].
        seed: of the search and of the twin's draws.
    """

    suffix: ClassVar[str] = ".npz"
    is_policy: ClassVar[bool] = False

    def __init__(
        self,
        *,
        bank: Name | None = None,
        known: Name | None = None,
        movements: Mapping[str, Any] | None = None,
        searched: Sequence[Name] | None = None,
        candidates: Count = 64,
        trials: Count = 4,
        elite: Count = 8,
        rounds: Count = 10,
        spread: Positive = 0.15,
        pace: Positive = 1.0,
        control_dt: Positive = 0.04,
        seed: Seed = 0,
    ):
        self.search = CrossEntropySearch(
            candidates=candidates,
            trials=trials,
            elite=elite,
            rounds=rounds,
            spread=spread,
            seed=seed,
        )
        if known is not None or movements is None:
            self.known = load_rises(DEFAULT, None if known is None else Path(known))
        else:
            self.known = written_rises(DEFAULT, movements)
        self.names = list(self.known.names if searched is None else searched)
        if unknown := [name for name in self.names if name not in self.known.names]:
            known_names = ", ".join(self.known.names)
            raise ValueError(f"searched must be of {known_names}, got {unknown[0]}.")
        self.control_dt = control_dt
        check_number(pace, "pace", lambda x: x > 0, "be positive")
        ends = self.known.ends.clone()
        ends[[self.known.names.index(name) for name in self.names]] *= pace
        self.known = self.known._replace(ends=ends)
        self.bank = lying_path(DEFAULT) if bank is None else Path(bank)
        load_lying(DEFAULT, self.bank)

    def make(self, path: Path, console: Console) -> None:
        """Writes the movements, and ``outcomes.txt`` with what comes of each."""
        progress, known = Progress(path.parent), self.known
        rises = known._replace(keyframes=known.keyframes.clone())
        if progress.found is not None:
            rises = load_rises(DEFAULT, progress.found)
        if left := self.names[len(progress.lines) :]:
            search = self.search
            count = search.candidates * search.trials
            worlds = LyingWorlds(count, self.bank, control_dt=self.control_dt)
        for name in left:
            worlds.env.set_seed(search.seed)  # so that it is the same by itself
            line = f"{name}: {self._searched(worlds, rises, name)}"
            console.print(line, soft_wrap=True)
            progress.add(line, lambda file: save_rises(file, rises))
        save_rises(path, rises)
        progress.end(path.with_name(OUTCOMES))

    def stand_in(self, path: Path) -> None:
        """Writes the movements with which the search begins."""
        save_rises(path, self.known)

    def _searched(self, worlds: LyingWorlds, rises: Rises, name: str) -> str:
        """Searches a movement; what came of it."""
        if not len(worlds.rows(rises, rises.names.index(name))):
            return "no starts for it, left as is"
        before, after = search_rise(worlds, rises, name, self.search)
        shares = [f"{each.reached.float().mean():.2f}" for each in (before, after)]
        scores = [f"{each.score.mean():.2f}" for each in (before, after)]
        return f"{' -> '.join(shares)} reach it, score {' -> '.join(scores)}"
