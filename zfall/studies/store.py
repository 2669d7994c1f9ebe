"""The stored results of studies: found by what they follow from, whatever study they belong to.

``RESULTS/results/NAME.jsonl`` has a line for each result of the study, with its figures, versions,
and the digests of what it follows from; a line before it has that itself, once for all results
that share it::

    {"id": "5d41402abc4b", "training": {"config": {...}, "contents": {...}}}
    {"result": {"success": 0.9, ...}, "row": "none", "training": "5d41402abc4b", ...}

A result is that of a test if both mean the same (``zfall.meaning``).
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import pandas as pd
from filelock import FileLock
from omegaconf import DictConfig

from zfall.errors import in_one_line
from zfall.files import written_whole
from zfall.fingerprints import digest
from zfall.meaning import differences, meaning, strict
from zfall.studies.inputs import combined, training_digest
from zfall.versions import versions

if TYPE_CHECKING:
    from zfall.studies.plan import Run, Test

_SHARED = ("training", "world", "battery", "curve")  # what results refer to
_CONFIGS = ("training", "world")


@dataclass(frozen=True)
class Stored:
    """A stored result.

    Attributes:
        figures: by name; NaN where there was nothing to count.
        curve: ``frames``, ``episode_return`` and ``episode_seconds`` of the training.
        meaning: of all that it follows from.
        shown: study, row, seed and test for which it was made.
    """

    figures: Mapping[str, float]
    curve: pd.DataFrame
    meaning: Mapping[str, str]
    shown: str


@dataclass(frozen=True)
class Store:
    """The two folders of a study, which others may share.

    Args:
        results: of the tables; ``results/*.jsonl`` in it are the stored results.
        runs: of the run folders.
    """

    results: Path
    runs: Path
    _read: dict[Path, tuple[tuple[int, int], dict[str, Stored]]] = field(default_factory=dict)

    def find(self, test: "Test") -> Stored | None:
        """The stored result of a test."""
        every = (stored for _, stored in self._files())
        return next((stored[test.name] for stored in every if test.name in stored), None)

    def unfinished(self, run: "Run") -> list["Test"]:
        """Tests of a run that have no stored result."""
        return [test for test in run.tests if self.find(test) is None]

    def run_folder(self, cfg: DictConfig) -> Path:
        """Where a training of this config lies, whatever study or row it is for."""
        return self.runs / training_digest(cfg)

    def write(
        self,
        test: "Test",
        who: Mapping[str, Any],
        figures: Mapping[str, float],
        curve: pd.DataFrame,
    ) -> None:
        """Adds the result of a finished test to the file of its study.

        Args:
            test: which.
            who: ``study``, ``row`` and ``seed``, and its title as ``test`` if it has one.
            figures: by name.
            curve: of the training.
        """
        folder = self.results / "results"
        for each in (folder, self.runs):
            each.mkdir(parents=True, exist_ok=True)
        path = folder / f"{who['study']}.jsonl"
        entry = {"result": figures, **who, "versions": versions()}
        with FileLock(self.runs / f"{path.stem}.lock"):  # launchers' processes write the same file
            text = path.read_text() if path.exists() else ""
            text += lines_of(entry | dict(test.inputs) | {"curve": curve.to_dict("list")}, text)
            with written_whole(path) as new:
                new.write_text(text)
        self.failure(test).unlink(missing_ok=True)

    def failure(self, test: "Test") -> Path:
        """The file that says why a test has no result."""
        return self.runs / f"{test.name}.failed"

    def mark_failed(self, test: "Test", error: Exception) -> None:
        """Writes down why a test has no result."""
        self.runs.mkdir(parents=True, exist_ok=True)
        self.failure(test).write_text(in_one_line(error))

    def why_missing(self, test: "Test") -> str:
        """What stands in the place of figures that are not there."""
        why = self.failure(test)
        return f"failed: {shorten(why.read_text(), 100)}" if why.exists() else "not run"

    def nearest(self, test: "Test") -> str:
        """Which stored result differs least from a test, and where."""
        stored = [each for _, file in self._files() for each in file.values()]
        if not stored:
            return f"{self.results / 'results'} has no stored results"
        differing = {each.shown: differences(each.meaning, test.meaning) for each in stored}
        shown, keys = min(differing.items(), key=lambda item: len(item[1]))
        more = f" and {len(keys) - 3} more keys" if len(keys) > 3 else ""
        return f"the nearest stored result, {shown}, differs in {', '.join(keys[:3])}{more}"

    def _files(self) -> Iterator[tuple[Path, dict[str, Stored]]]:
        """The files of stored results, read again when they change."""
        for path in sorted((self.results / "results").glob("*.jsonl")):
            state = path.stat()
            changed = (state.st_mtime_ns, state.st_size)
            if self._read.get(path, (None,))[0] != changed:
                found = {digest(each.meaning): each for each in read(path)}
                self._read[path] = (changed, found)
            yield path, self._read[path][1]


def lines_of(entry: Mapping[str, Any], before: str = "") -> str:
    """The lines of a result, with those of what it shares that are not there ``before``.

    Args:
        entry: the result, with all that it follows from in full.
        before: the text of the file so far.
    """
    lines: list[str] = []

    def shared(kind: str, value: Any) -> str:
        name = digest(value)
        line = json.dumps({"id": name, kind: value})
        if line not in lines and f"{line}\n" not in before:
            lines.append(line)
        return name

    own: dict[str, Any] = strict(entry)
    for kind in _SHARED:
        if kind in own:
            own[kind] = shared(kind, own[kind])
    if "others" in own:
        own["others"] = [shared("training", other) for other in own["others"]]
    return "".join(f"{line}\n" for line in [*lines, json.dumps(own)])


def read(path: Path) -> Iterator[Stored]:
    """The results of a file.

    Raises:
        ValueError: on a line that is not JSON, or refers to one that is not there.
    """
    values: dict[str, Any] = {}
    for number, line in enumerate(path.read_text().splitlines(), 1):
        try:
            entry = json.loads(line)
            if "id" in entry:
                kind = next(kind for kind in _SHARED if kind in entry)
                value = entry[kind]
                values[entry["id"]] = meaning(**value) if kind in _CONFIGS else value
                continue
            yield _stored(entry, values)
        except (ValueError, KeyError, TypeError, AttributeError, StopIteration) as error:
            raise ValueError(
                f"{path}, line {number}, must be a stored result or what one refers to, "
                f"got {shorten(line, 60)!r} ({type(error).__name__}: {error})."
            ) from error


def _stored(entry: Mapping[str, Any], values: Mapping[str, Any]) -> Stored:
    full = {key: values[each] if key in _SHARED else each for key, each in entry.items()}
    if "others" in full:
        full["others"] = [values[each] for each in full["others"]]
    figures = {key: _number(each) for key, each in full.pop("result").items()}
    curve = {key: list(map(_number, each)) for key, each in full.pop("curve").items()}
    who = {key: full.pop(key) for key in ("study", "row", "seed", "test") if key in full}
    full.pop("versions", None)
    shown = f"{who['row']} of {who['study']} (seed {who['seed']}"
    shown += f", {who['test']})" if "test" in who else ")"
    return Stored(figures, pd.DataFrame(curve), combined(full), shown)


def _number(value: Any) -> Any:
    """A number, ``.nan`` and ``.inf`` among them."""
    return float(value.replace(".", "")) if isinstance(value, str) else value
