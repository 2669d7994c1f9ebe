"""One file that shows a run or a comparison: numbers, figures, film, and how to get them again."""

import base64
import json
import platform
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment

from zfall.commands import shell_line, shown_path
from zfall.evaluation.curves import SIZE, Panel, panels
from zfall.evaluation.lost_trials import can_be_shown, film_line, lost_trials
from zfall.evaluation.results import labels
from zfall.evaluation.run_files import read_summary, read_table, reading
from zfall.evaluation.statistics import error_of
from zfall.files import written_whole
from zfall.terminal import text_of
from zfall.trust import texts_of_file
from zfall.versions import versions

CAPTIONS = {
    "success_map": "Share of trials recovered, by direction and impulse of the push.",
    "planar": "Share of trials recovered in the short battery at the end of training.",
    "withstood": "Pushes withstood in a row, by impulse, duration and push point.",
    "envelope": "Largest impulse recovered from, by direction and push point.",
    "overlay": "I50 by direction of all runs.",
    "profiles": "Share of directions in which I50 is at least as large.",
    "draws": "Share recovered by thirds of what was drawn; what explains most at the top.",
    "bands": "Learning curves, mean and interval over seeds.",
}


LONG = 24  # rows of a table that are shown at once


@dataclass
class Section:
    """A part of the page: paragraphs, tables (html), curves, figures, a video, listings.

    ``lost`` are trials with their ``line`` to be filmed.
    """

    title: str
    notes: list[str] = field(default_factory=list)
    tables: list[str] = field(default_factory=list)
    curves: list[Panel] = field(default_factory=list)
    lost: list[dict[str, Any]] = field(default_factory=list)
    figures: list[dict[str, Any]] = field(default_factory=list)
    video: str = ""
    listings: list[dict[str, str]] = field(default_factory=list)


def write_report(folder: Path, command: str = "") -> Path:
    """Writes ``report.html`` of a run folder, or of the folder of a comparison, from its files.

    Args:
        folder: which.
        command: with which a comparison was started.

    Returns:
        The page, which holds everything it shows.

    Raises:
        ValueError: if one of the files is damaged, naming it.
    """
    sections = [_training(folder)] if (folder / "metrics.csv").exists() else []
    batteries = [path.parent for path in folder.glob("evaluation/*/summary.json")]
    sections += [_battery(folder, path) for path in sorted(batteries, key=_planar_first)]
    if (folder / "comparison.csv").exists():
        sections.append(_comparison(folder))
    film = folder / "video.mp4"
    if film.exists():
        text = "Above the policy, below pose_hold; the arrow shows where a push comes from."
        sections.append(Section("Film", notes=[text], video=_encoded(film)))
    sections.append(_reproduction(folder))
    here = f"{platform.python_implementation()} {platform.python_version()}"
    made = ", ".join(f"{name} {value}" for name, value in versions().items())
    template = files("zfall.evaluation").joinpath("report.html.j2").read_text()
    page = (
        Environment(autoescape=True)
        .from_string(template)
        .render(
            title=_title(folder),
            facts=_facts(folder, command),
            made=f"{made}; {here}",
            sections=sections,
            size=SIZE,
        )
    )
    path = folder / "report.html"
    with written_whole(path) as new:
        new.write_text(page)
    return path


def _title(folder: Path) -> str:
    """The experiment and the ``name`` that the shell gave to a run, and its folder."""
    given = _given(folder)
    said = [given[key] for key in ("name", "experiment") if given.get(key, "null") != "null"]
    return ", ".join([*said, folder.name])


def _given(folder: Path) -> dict[str, str]:
    """What the shell gave to a run."""
    overrides = folder / ".hydra" / "overrides.yaml"
    texts = texts_of_file(overrides) if overrides.exists() else []
    return dict(text.split("=", 1) for text in texts if "=" in text)


def _facts(folder: Path, command: str) -> list[tuple[str, str, bool]]:
    """What the page is about: words, and whether they are code."""
    overrides = folder / ".hydra" / "overrides.yaml"
    if not overrides.exists():
        return [("command", command, True)] if command else []
    given = _given(folder)
    line = shell_line("train", shlex.join(texts_of_file(overrides)))
    facts = [
        ("run", given.get("name", "null"), False),
        ("folder", shown_path(folder), True),
        ("experiment", given.get("experiment", "quickstart, the default"), False),
        ("trained with", _version_of(folder / ".hydra" / "versions.json"), False),
        ("command", line, True),
    ]
    return [fact for fact in facts if fact[1] != "null"]


def _version_of(path: Path) -> str:
    """Version and commit in a file that a run keeps of its code."""
    return _code_of(read_summary(path)) if path.exists() else "a version that was not recorded"


def _code_of(found: Mapping[str, Any]) -> str:
    commit = f", commit {found['commit']}" if "commit" in found else ""
    return f"zfall {found.get('zfall', 'of an unknown version')}{commit}"


def _planar_first(battery: Path) -> tuple[bool, str]:
    return not battery.name.startswith("planar"), battery.name


def _training(folder: Path) -> Section:
    metrics = read_table(path := folder / "metrics.csv")
    with reading(path):
        frames = metrics["frames"].max()
        last = metrics.tail(10).mean(numeric_only=True)
        names = ["episode_return", "episode_seconds", "terminated", "kl"]
        rows = pd.DataFrame(
            {"mean of the last ten updates": [name for name in names if name in last]}
        ).assign(value=lambda t: [f"{last[name]:.4g}" for name in t.iloc[:, 0]])
        notes = [f"{frames / 1e6:.2f} million control steps, {len(metrics)} updates."]
    if (path := folder / "timing.csv").exists():
        timing = read_table(path)
        with reading(path):
            seconds = timing["collect_s"].sum() + timing["learn_s"].sum()
            notes.append(f"{seconds / 60:.1f} minutes, {frames / seconds:.0f} control steps/s.")
    out = Section("Training", notes=notes, tables=[_html(rows)])
    with reading(folder / "metrics.csv"):
        out.curves = panels({"": metrics})
    drawn = sorted((folder / "plots").glob("*.png"))
    out.figures = [_figure(path) for path in drawn if path.stem != "learning_curves"]
    return out


def _battery(run: Path, folder: Path) -> Section:
    summary = read_summary(path := folder / "summary.json")
    with reading(path):
        notes, tables = _headlines(summary)
        if "versions" in summary:
            notes.append(f"Run with {_code_of(summary['versions'])}.")
    tables += [_html(read_table(path)) for path in _tables(folder)]
    figures = [_figure(path) for path in sorted(folder.glob("*.png"))]
    title = f"Battery {folder.name.replace('_', ' ')}"
    lost = _lost(run, folder, summary)
    return Section(title, notes=notes, tables=tables, figures=figures, lost=lost)


def _lost(run: Path, folder: Path, summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The trials lost to the smallest pushes, each with its line."""
    path = folder / "trials.csv"
    if not path.exists() or not can_be_shown(trials := read_table(path)):
        return []
    with reading(path):
        rows = lost_trials(trials).to_dict("records")
    return [
        {
            "cells": {str(key): text_of(value) for key, value in row.items()},
            "line": film_line(run, summary, folder.name, row["trial"]),
        }
        for row in rows
    ]


def _headlines(summary: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """What the summary of a battery says, and its table of sizes, if it has them."""
    notes = [
        f"Battery version {summary['battery_version']}, {summary['n']} trials, seed "
        f"{summary['seed']}; falls without a push: {summary['control_falls']} of "
        f"{summary['control_n']}."
    ]
    if "i50_mean" not in summary:
        return notes, []
    notes.append(
        f"I50: mean {summary['i50_mean']:.3f}{error_of(summary)}, least "
        f"{summary['i50_min']:.2f} over directions; I90: mean {summary['i90_mean']:.3f}, "
        f"least {summary['i90_min']:.2f}."
    )
    rows = [
        {
            "impulse I": size,
            "force [N]": f"{summary['force_n'][size]:.1f}",
            "recovered": f"{100 * rate:.1f} %",
            "95 % interval": f"{100 * summary['success_low'][size]:.1f} to "
            f"{100 * summary['success_high'][size]:.1f} %",
        }
        for size, rate in summary["success"].items()
    ]
    return notes, [_html(pd.DataFrame(rows))]


def _comparison(folder: Path) -> Section:
    note = "Differences are to the first run, on the same trials; p is of McNemar's exact test."
    tables = [_html(read_table(path)) for path in _tables(folder)]
    out = Section("Comparison", notes=[note], tables=tables)
    out.curves = panels(trained) if len(trained := _trained(folder)) > 1 else []
    drawn = [path for path in sorted(folder.glob("*.png")) if path.stem != "learning_curves"]
    out.figures = [_figure(path) for path in drawn]
    return out


def _trained(folder: Path) -> dict[str, pd.DataFrame]:
    """Rows of ``metrics.csv`` of the runs that are compared, as far as they are there."""
    runs = {name: Path(name) / "metrics.csv" for name in read_summary(folder / "summary.json")}
    there = [name for name, path in runs.items() if path.exists()]
    tables = [read_table(runs[name]) for name in there]
    return dict(zip(labels(there), tables, strict=True))


def _tables(folder: Path) -> list[Path]:
    """Tables to show: all but ``trials.csv`` and traces of single trials; comparisons first."""
    paths = [path for path in folder.glob("*.csv") if not path.name.startswith("trial")]
    return sorted(paths, key=lambda path: (path.stem != "comparison", path.stem))


def _reproduction(folder: Path) -> Section:
    out = Section("To get this again")
    if (folder / "comparison.csv").exists():
        summaries = read_summary(path := folder / "summary.json")
        with reading(path):
            given = json.dumps(next(iter(summaries.values()))["definition"], indent=2)
        out.listings.append({"title": "definition of the battery", "body": given})
    for name in ("config.yaml", "overrides.yaml"):
        path = folder / ".hydra" / name
        if path.exists():
            with reading(path):
                out.listings.append({"title": name, "body": path.read_text()})
    for path in sorted(folder.glob("evaluation/*/summary.json")):
        given = json.dumps(read_summary(path).get("definition", {}), indent=2)
        out.listings.append({"title": f"definition of {path.parent.name}", "body": given})
    return out


def _html(rows: pd.DataFrame) -> str:
    """A table; a long one behind a fold."""
    table = rows.to_html(index=False, border=0, float_format=lambda x: f"{x:.3g}", na_rep="-")
    table = re.sub("<th>[^<]*</th>", lambda head: head[0].replace("_", "_<wbr>"), table)
    if len(rows) <= LONG:
        return table
    return f"<details><summary>{len(rows)} rows</summary>{table}</details>"


def _figure(path: Path) -> dict[str, Any]:
    caption = CAPTIONS.get(path.stem, path.stem.replace("_", " "))
    wide = path.stem in ("withstood", "envelope")
    return {"caption": caption, "data": _encoded(path), "wide": wide}


def _encoded(path: Path) -> str:
    return base64.b64encode(path.read_bytes()).decode()
