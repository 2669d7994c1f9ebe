"""Who acts in the viewer: names to choose from, and the players of a choice."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from omegaconf import DictConfig

from zfall.envs.worlds import in_world
from zfall.evaluation.baselines import baseline_names
from zfall.evaluation.candidate import Candidate, load_candidate, load_candidates
from zfall.evaluation.definitions import load_battery
from zfall.policies.load import POLICIES, checkpoint_of
from zfall.viewer.player import Player

NOBODY = "nobody"  # to compare with


class WatchedFile:
    """Says whether a file has been written since it was looked at before.

    Args:
        path: of the file, which may not be there yet; ``None``: there is none to watch.
    """

    def __init__(self, path: Path | None):
        self._path = path
        self._written = self._time()

    def changed(self) -> bool:
        """Whether it is newer than at the last call, or than when it began to be watched."""
        before, self._written = self._written, self._time() or self._written
        return self._written != before

    def _time(self) -> int | None:
        try:
            return None if self._path is None else self._path.stat().st_mtime_ns
        except FileNotFoundError:
            return None


@dataclass(frozen=True)
class Casting:
    """How candidates are loaded.

    Args:
        worlds: how many there are in all; with somebody to compare with, each gets half.
        seed: of the starts.
        checkpoint: of run folders.
        change: values of all envs to replace.
        task: the env of a baseline that stands alone; ``None``: ``push_recovery``.
        battery: the name of a battery whose hardware replaces the env's, ``twin``.
        runs: folder that is searched for run folders.
    """

    worlds: int = 4
    seed: int = 0
    checkpoint: str = "last"
    change: Sequence[str] = ()
    task: DictConfig | None = None
    battery: str | None = None
    runs: Path = Path("runs")

    def players(self, run: str, compare: str = NOBODY) -> list[Player]:
        """The player of a run, and of whom it is compared with.

        Raises:
            ValueError: if there is no such policy, they cannot be shown together, or there are too
                few worlds for both.
        """
        both = [run] if compare == NOBODY else [run, compare]
        if len(both) > self.worlds:
            raise ValueError(f"worlds must be at least 2 to compare, got {self.worlds}.")
        world = load_battery(self.battery).world if self.battery else None
        baselines_alone = all(name in baseline_names() for name in both)
        found = load_candidates(
            both,
            task=self.task if baselines_alone else None,
            checkpoint=self.checkpoint,
            change=self.change,
            world=world,
        )
        found = [replace(each, env_cfg=in_world(each.env_cfg, world)) for each in found]
        counts = [self.worlds - self.worlds // 2, self.worlds // 2]
        counts = counts if len(found) == 2 else [self.worlds]
        pairs = zip(found, counts, strict=True)
        players = [Player(each, count, self.seed) for each, count in pairs]
        rates = {each.label: player.control_dt for each, player in zip(found, players, strict=True)}
        if len(set(rates.values())) > 1:
            shown = ", ".join(f"{name} {rate:g} s" for name, rate in rates.items())
            raise ValueError(f"run and compare must have the same control_dt, got {shown}.")
        return players

    def reload(self, run: str) -> Candidate:
        """The policy of a run folder as its file is now."""
        return load_candidate(run, checkpoint=self.checkpoint, change=self.change)

    def file_of(self, run: str) -> Path | None:
        """The file that a run folder's policy is read from; ``None`` of others."""
        if not Path(run).is_dir() or run in self.fixed():
            return None
        return checkpoint_of(run, self.checkpoint)

    @staticmethod
    def fixed() -> list[str]:
        """Policies that ship, and baselines."""
        return [*sorted(path.stem for path in POLICIES.glob("*.pt")), *baseline_names()]

    def choices(self) -> list[str]:
        """All that can be chosen; run folders, the newest first, come last."""
        found = {
            path.parent.parent: path.stat().st_mtime
            for depth in ("*", "*/*", "*/*/*")
            for path in self.runs.glob(f"{depth}/checkpoints/{self.checkpoint}.pt")
        }
        newest = sorted(found, key=lambda folder: -found[folder])
        return [*self.fixed(), *map(str, newest[:20])]
