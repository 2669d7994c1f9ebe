"""Makers of stages for tests: each writes a few bytes, or a policy."""

from pathlib import Path
from typing import ClassVar

from rich.console import Console

from zfall import checkpoint


class Text:
    """Writes a text, which may stand for the file of another stage, and counts how often."""

    suffix: ClassVar[str] = ".txt"
    is_policy: ClassVar[bool] = False
    made: ClassVar[list[str]] = []  # names of files, in their order
    dies: ClassVar[list[BaseException]] = []  # of which each ends one attempt

    def __init__(self, *, text: str, after: str | None = None):
        if not text:
            raise ValueError(f"text must not be empty, got {text!r}.")
        self.text, self.after = text, after

    def make(self, path: Path, console: Console) -> None:
        before = Path(self.after).read_text() if self.after else ""
        path.write_text(before[:1])  # half of it
        (path.parent / "report.md").write_text(self.text)
        if self.dies:
            raise self.dies.pop()
        path.write_text(before + self.text)
        self.made.append(path.name)

    def stand_in(self, path: Path) -> None:
        path.write_text("x")


class Copy:
    """A policy: that of another stage."""

    suffix: ClassVar[str] = ".pt"
    is_policy: ClassVar[bool] = True

    def __init__(self, *, policy: str):
        self.policy = Path(policy)

    def make(self, path: Path, console: Console) -> None:
        content = checkpoint.load(self.policy)
        checkpoint.save(path, {key: content[key] for key in checkpoint.POLICY})

    def stand_in(self, path: Path) -> None:
        self.make(path, Console(quiet=True))


class Nothing(Text):
    """Writes nothing at all."""

    def make(self, path: Path, console: Console) -> None:
        pass
