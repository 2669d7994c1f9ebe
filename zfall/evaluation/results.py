"""Files of a battery's results: summaries, tables, figures."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import OmegaConf
from rich.console import Console

from zfall.evaluation.comparison import compare
from zfall.evaluation.definitions import Battery
from zfall.evaluation.pendulum import references
from zfall.evaluation.plots import (
    envelope_plot,
    overlay,
    profiles_plot,
    success_map,
    withstood_map,
)
from zfall.evaluation.showcase import table
from zfall.evaluation.statistics import head, summarize, summarize_spherical
from zfall.evaluation.strategies import strategy_table
from zfall.evaluation.summaries import write_summary
from zfall.falling.kneeling import PEAKS, compare_falls, summarize_kneel
from zfall.robots import Robot

FORMATS = ("png", "pdf")


def summary_of(battery: Battery, trials: pd.DataFrame) -> dict[str, Any]:
    """The figures of a battery, by its kind."""
    if battery.interval is not None:
        return summarize_spherical(battery, trials)
    if battery.forces:
        return head(battery, trials) | summarize_kneel(trials)
    return summarize(battery, trials)


def write_results(
    battery: Battery,
    trials: pd.DataFrame,
    baseline: pd.DataFrame | None,
    folder: Path,
    console: Console,
    *,
    name: str,
    robot: Robot,
) -> None:
    """Writes ``summary.json``, tables and figures of a battery, and prints its headlines.

    Args:
        battery: the definition.
        trials: with their outcomes.
        baseline: of ``pose_hold`` in a planar battery.
        folder: where to, named by the battery and its setting.
        console: to print on.
        name: of the policy.
        robot: whose reference lines are drawn.
    """
    summary = summary_of(battery, trials)
    write_summary(folder, summary)
    title = f"{name}, {folder.name.replace('_', ' ')}"
    written = ["trials.csv", "summary.json"]
    if battery.interval is not None:
        rows = pd.DataFrame(summary["withstood"])
        written += _figures(folder, "withstood", lambda p: withstood_map(trials, p, title=title))
        written += _table(folder, "withstood", rows)
        console.print(markdown(rows), markup=False, soft_wrap=True)
    elif battery.forces:
        rows = kneel_table(summary)
        written += _table(folder, "outcomes", rows)
        console.print(markdown(rows), markup=False, soft_wrap=True)
        values = {peak: summary[f"grid_falls_{peak}_mean"] for peak in PEAKS}
        means = ", ".join(f"{k} {v:.3g}" for k, v in values.items() if v is not None)
        console.print(f"means over {summary['grid_falls']} falls: {means}")
    else:
        lines = references(robot, battery.durations[0])
        written += _figures(
            folder,
            "success_map",
            lambda p: success_map(trials, p, title=title, baseline=baseline, lines=lines),
        )
        written += _table(folder, "strategies", strategy_table(trials))
        console.print(table({name: summary}))
        console.print(
            f"I50 mean {summary['i50_mean']:.3f}, least {summary['i50_min']:.2f}; "
            f"I90 mean {summary['i90_mean']:.3f}"
        )
    console.print(f"falls without a push {summary['control_falls']} of {summary['control_n']}")
    console.print(f"wrote {folder}/{', '.join(written)}", soft_wrap=True)


def write_envelope(
    battery: Battery,
    tables: Mapping[str, pd.DataFrame],
    trials: pd.DataFrame,
    folder: Path,
    console: Console,
    *,
    robot: Robot,
) -> None:
    """Writes the largest impulses of a policy, the first of ``tables``, beside the others'."""
    own = next(iter(tables.values()))
    own.to_csv(folder / "envelope.csv", index=False)
    means = own.groupby("body", sort=False)["largest"].agg(["mean", "min"])
    summary = head(battery, trials) | {
        "largest_mean": means["mean"].to_dict(),
        "largest_min": means["min"].to_dict(),
    }
    write_summary(folder, summary)
    title = "largest impulse recovered from"
    lines = references(robot, battery.durations[0])
    written = ["trials.csv", "envelope.csv", "summary.json"]
    written += _figures(
        folder, "envelope", lambda p: envelope_plot(tables, p, title=title, lines=lines)
    )
    console.print(markdown(means.reset_index()), markup=False)
    console.print(f"wrote {folder}/{', '.join(written)}", soft_wrap=True)


def write_comparison(
    battery: Battery,
    results: dict[str, pd.DataFrame],
    folder: Path,
    console: Console,
    *,
    robot: Robot,
) -> None:
    """One table, and for planar batteries one overlay plot, of several runs on the same trials."""
    summaries = {name: summary_of(battery, trials) for name, trials in results.items()}
    short = dict(zip(results, labels(list(results)), strict=True))
    named = {short[name]: trials for name, trials in results.items()}
    figures = tuple(key for key, v in next(iter(summaries.values())).items() if _is_figure(key, v))
    paired = compare(results)
    for figure in figures:
        paired[figure] = [summaries[name][figure] for name in paired["run"]]
    written = _table(folder, "comparison", paired)
    if battery.forces:
        tables = [kneel_table(summaries[name]) for name in results]
        written += _table(
            folder, "outcomes", pd.concat(tables, keys=short.values()).reset_index(0, names="run")
        )
        written += _table(folder, "falls", compare_falls(named))
    planar = battery.interval is None and not battery.forces
    if planar:
        lines = references(robot, battery.durations[0])
        title = f"I50, {folder.name.replace('_', ' ')}"
        written += _figures(
            folder, "overlay", lambda p: overlay(named, p, title=title, lines=lines)
        )
        written += _figures(folder, "profiles", lambda p: profiles_plot(named, p, title=title))
        console.print(table({short[name]: summary for name, summary in summaries.items()}))
    write_summary(folder, summaries)
    console.print((folder / "comparison.md").read_text(), markup=False, soft_wrap=True)
    console.print(f"wrote {folder}/{', '.join(written)}", soft_wrap=True)


def _is_figure(key: str, value: Any) -> bool:
    """Whether an entry of a summary is a single number that tells policies apart."""
    same = ("battery_version", "seed", "n", "control_n")
    return isinstance(value, (int, float)) and key not in same


def kneel_table(summary: dict[str, Any]) -> pd.DataFrame:
    """Outcomes of battery ``kneel``: a row for each push of the list, each size, each heading."""
    rows = []
    groups = {"force [N]": "listed", "I": "by_impulse", "heading [deg]": "by_direction"}
    for label, entries in ((label, summary[name]) for label, name in groups.items()):
        for push, entry in entries.items():
            row = {"push": f"{label} {push}", "n": entry["n"]}
            for key in ("recovered", "kneeled", "clean", "untouched"):
                row[key] = _percent(*(entry[f"{key}{end}"] for end in ("", "_low", "_high")))
            for key in PEAKS:
                row[key] = _interval(*(entry[f"{key}{end}"] for end in ("", "_low", "_high")))
            rows.append(row)
    return pd.DataFrame(rows)


def _percent(value: float | None, low: float | None, high: float | None) -> str:
    if value is None or low is None or high is None:
        return "-"
    return f"{100 * value:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def _interval(value: float | None, low: float | None, high: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if low is None or high is None else f"{value:.3g} [{low:.3g}, {high:.3g}]"


def _figures(folder: Path, name: str, draw: Callable[[Path], None]) -> list[str]:
    """Draws a figure in all formats; returns the files."""
    for ending in FORMATS:
        draw(folder / f"{name}.{ending}")
    return [f"{name}.{ending}" for ending in FORMATS]


def _table(folder: Path, name: str, rows: pd.DataFrame) -> list[str]:
    """Writes a table as csv and Markdown; returns the files."""
    rows.to_csv(folder / f"{name}.csv", index=False)
    (folder / f"{name}.md").write_text(markdown(rows))
    return [f"{name}.csv", f"{name}.md"]


def labels(names: list[str]) -> list[str]:
    """The last folder of each name, or the whole of it if two have the same.

    Jobs of a sweep, whose folders have numbers, by what was given to them and not to all: seed=1.
    """
    given = {name: _given_to(Path(name)) for name in names if Path(name).name.isdigit()}
    common = set.intersection(*map(set, given.values())) if given else set()
    own = {name: ", ".join(o for o in those if o not in common) for name, those in given.items()}
    last = [own.get(name) or Path(name).name for name in names]
    return [
        short if last.count(short) == 1 else name for short, name in zip(last, names, strict=True)
    ]


def _given_to(folder: Path) -> list[str]:
    """What the shell gave to a run."""
    path = folder / ".hydra" / "overrides.yaml"
    return list(OmegaConf.load(path)) if path.exists() else []


def markdown(rows: pd.DataFrame) -> str:
    """A table in Markdown, numbers with three digits."""
    cells = rows.map(lambda value: f"{value:.3g}" if isinstance(value, float) else str(value))
    lines = [list(rows.columns), ["---"] * rows.shape[1], *cells.to_numpy().tolist()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
