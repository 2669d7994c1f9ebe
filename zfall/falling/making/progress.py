"""How far a search has come, in files by which it goes on after it was cut."""

from collections.abc import Callable
from pathlib import Path

from zfall.files import written_whole


class Progress:
    """Lines of what came of each part of a search, and what was found by then.

    The file of a part is whole before its line says so.

    Attributes:
        lines: of the parts that are over.

    Args:
        folder: of the search.
    """

    def __init__(self, folder: Path):
        self.folder, self.text = folder, folder / "so_far.txt"
        self.lines = self.text.read_text().splitlines() if self.text.is_file() else []

    @property
    def found(self) -> Path | None:
        """The file after the last part that is over; None before the first."""
        return self._file(len(self.lines)) if self.lines else None

    def add(self, line: str, save: Callable[[Path], None]) -> None:
        """Notes that a part is over.

        Args:
            line: what came of it.
            save: writes what was found so far.
        """
        before = self.found
        save(self._file(len(self.lines) + 1))
        self.lines.append(line)
        with written_whole(self.text) as new:
            self._write(new)
        if before is not None:
            before.unlink(missing_ok=True)

    def end(self, outcomes: Path) -> None:
        """Leaves the lines in a file alone."""
        self._write(outcomes)
        for path in (self.found, self.text):
            if path is not None:
                path.unlink(missing_ok=True)

    def _write(self, path: Path) -> None:
        path.write_text("".join(f"{line}\n" for line in self.lines))

    def _file(self, number: int) -> Path:
        return self.folder / f"so_far_{number}.npz"
