"""What a battery found of a policy, and the files in which it is kept."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pandas as pd
from rich.console import Console

from zfall.evaluation.comparison import compare
from zfall.evaluation.definitions import Battery
from zfall.evaluation.followers import followers_of
from zfall.evaluation.headings import count, heading
from zfall.evaluation.kinds import kind_of
from zfall.evaluation.pendulum import Reference, references
from zfall.evaluation.plots import learning_curves
from zfall.evaluation.run_files import read_table
from zfall.evaluation.writers import Written, write_figures, write_summary, write_table
from zfall.robots import Robot
from zfall.terminal import Sheet, print_sheet
from zfall.trust import texts_of_file
from zfall.versions import versions

NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Result:
    """What a battery found of one policy.

    Attributes:
        battery: the definition.
        name: of the policy, as in tables and figures.
        robot: whose reference lines are drawn.
        trials: one a row, with their outcomes; the columns are those of ``trials.csv``.
        summary: headline figures, as in ``summary.json``.
        background: trials of ``pose_hold`` to be drawn with the policy's, if there are any.
        tables: of the battery's measures, by name.
        referenced: whether polar plots show the lines of a pendulum and of other robots.
        surroundings: servos and world, as figures say them.
    """

    battery: Battery
    name: str
    robot: Robot
    trials: pd.DataFrame
    summary: dict[str, Any]
    background: pd.DataFrame | None = None
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    referenced: bool = False
    surroundings: str = ""

    @property
    def lines(self) -> list[Reference]:
        """What polar plots compare with."""
        return references(self.robot, self.battery.durations[0]) if self.referenced else []

    def heading(self, counted: str, *, of: str = "") -> str:
        """Two lines over a figure, see ``headings.heading``.

        Args:
            counted: how many trials are behind a value.
            of: what is shown; empty: the policy's name.
        """
        where = self.surroundings
        return heading(of or self.name, self.battery, self.robot, where, counted)


def result_of(
    battery: Battery,
    name: str,
    robot: Robot,
    trials: pd.DataFrame,
    background: pd.DataFrame | None = None,
    known: Mapping[str, Any] = NOTHING,
    *,
    referenced: bool = False,
    surroundings: str = "",
) -> Result:
    """The result of these trials, summed up as the battery's kind and measures do.

    Args:
        battery: the definition.
        name: of the policy.
        robot: of its env.
        trials: with their outcomes.
        background: those of ``pose_hold``.
        known: what the summary says in addition.
        referenced: whether polar plots have reference lines.
        surroundings: servos and world, as figures say them.
    """
    summary, tables = kind_of(battery).summary(battery, trials) | dict(known), {}
    for follower in followers_of(battery):
        if not hasattr(follower, "summary"):
            continue
        for key, value in follower.summary(trials).items():
            if isinstance(value, pd.DataFrame):
                tables[key], value = value, value.to_dict("records")
            summary[key] = value
    plain: dict[str, Any] = {"referenced": referenced, "surroundings": surroundings}
    return Result(battery, name, robot, trials, summary, background, tables, **plain)


def write_results(
    result: Result, folder: Path, console: Console, given: Sequence[str] | None = None
) -> None:
    """Writes ``summary.json``, tables and figures of a battery, and prints its headlines.

    Args:
        result: of one policy; ``trials.csv`` is there already.
        folder: where to, named by the battery and its setting.
        console: to print on.
        given: what the shell gave to the recipe besides the run, to show a trial again.
    """
    made: dict[str, Any] = {"versions": versions()}
    made |= {} if given is None else {"given": list(given)}
    write_summary(folder, result.summary | made)
    written = kind_of(result.battery).write(result, folder)
    for name, table in result.tables.items():
        written.files += write_table(folder, name, table)
    title = result.heading(count(result.trials, (), "pushed trials"))
    for follower in followers_of(result.battery):
        if hasattr(follower, "figures"):
            written.files += follower.figures(result.trials, folder, title)
    _print(written, console)
    summary = result.summary
    console.print(f"falls without a push {summary['control_falls']} of {summary['control_n']}")
    _print_files(folder, ["trials.csv", "summary.json", *written.files], console)


def write_comparison(results: Mapping[str, Result], folder: Path, console: Console) -> None:
    """One table of several runs on the same trials, and what the battery's kind draws of them.

    Args:
        results: by run; all of one battery.
        folder: where to.
        console: to print on.
    """
    battery = next(iter(results.values())).battery
    summaries = {name: result.summary for name, result in results.items()}
    paired = compare({name: result.trials for name, result in results.items()})
    for figure in [key for key, v in next(iter(summaries.values())).items() if _is_figure(key, v)]:
        paired[figure] = [summaries[name][figure] for name in paired["run"]]
    files = write_table(folder, "comparison", paired)
    labelled = dict(zip(labels(list(results)), results.values(), strict=True))
    written = kind_of(battery).compare(_told_apart(labelled), folder)
    trained = {
        label: read_table(path)
        for label, name in zip(labelled, results, strict=True)
        if (path := Path(name) / "metrics.csv").exists()
    }
    if len(trained) > 1:
        draw = partial(learning_curves, trained)
        files += write_figures(folder, "learning_curves", draw)
    write_summary(folder, summaries)
    _print(written, console)
    named = paired.assign(run=list(labelled))
    print_sheet(Sheet(named, file=str(folder / "comparison.csv")), console)
    _print_files(folder, files + written.files, console)


def _told_apart(results: Mapping[str, Result]) -> dict[str, Result]:
    """The same, but labels say what differs in servos or worlds, and headings the rest."""
    words = {label: each.surroundings.split(", ") for label, each in results.items()}
    common = [word for word in next(iter(words.values())) if all(word in x for x in words.values())]
    told = {}
    for label, each in results.items():
        own = ", ".join(word for word in words[label] if word not in common)
        told[f"{label} ({own})" if own else label] = replace(each, surroundings=", ".join(common))
    return told


def _is_figure(key: str, value: Any) -> bool:
    """Whether an entry of a summary is a single number that tells policies apart."""
    same = ("battery_version", "seed", "n", "control_n")
    return isinstance(value, (int, float)) and key not in same


def _print(written: Written, console: Console) -> None:
    for each in written.shown:
        if isinstance(each, Sheet):
            print_sheet(each, console)
        else:
            console.print(each, markup=False, soft_wrap=True)


def _print_files(folder: Path, names: list[str], console: Console) -> None:
    console.print(f"wrote {folder}/{', '.join(names)}", soft_wrap=True)


def labels(names: list[str]) -> list[str]:
    """What ``name`` of a run gave, else its last folder; the whole name if two have the same.

    Jobs of a sweep, whose folders have numbers, by what was given to them and not to all: seed=1.
    """
    given = {name: _given_to(Path(name)) for name in names if Path(name).name.isdigit()}
    common = set.intersection(*map(set, given.values())) if given else set()
    own = {name: ", ".join(o for o in those if o not in common) for name, those in given.items()}
    last = [_said_of(Path(name)) or own.get(name) or Path(name).name for name in names]
    return [
        short if last.count(short) == 1 else name for short, name in zip(last, names, strict=True)
    ]


def _said_of(folder: Path) -> str | None:
    """The ``name`` that the shell gave to a run, if it did."""
    named = [o.removeprefix("name=") for o in _given_to(folder) if o.startswith("name=")]
    return named[-1] if named and named[-1] != "null" else None


def _given_to(folder: Path) -> list[str]:
    """What the shell gave to a run."""
    path = folder / ".hydra" / "overrides.yaml"
    return texts_of_file(path) if path.exists() else []
