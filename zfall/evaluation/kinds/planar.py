"""One push in a level direction: which sizes are recovered from."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from zfall.evaluation.definitions import Battery, check_single, check_unused
from zfall.evaluation.headings import count
from zfall.evaluation.kinds import Figures
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import Pushes, grid, single_pushes
from zfall.evaluation.plots import overlay, profiles_plot, success_map
from zfall.evaluation.results import Result
from zfall.evaluation.statistics import error_of, summarize
from zfall.evaluation.strategies import strategy_table
from zfall.evaluation.writers import Written, write_figures, write_table
from zfall.terminal import Sheet


class Planar:
    """Directions x sizes x starts; the headline is I50, the largest size withstood."""

    independent: ClassVar[bool] = True
    baseline_task: ClassVar[str] = "push_recovery"
    study_figures: ClassVar[Figures] = {
        "i50_mean": ("mean I50", 3),
        "i50_min": ("least I50", 2),
        "success": ("success", 3),
        "target_smoothness": ("smoothness [mrad]", 2),
        "joint_torque_rms": ("torque, smallest push [N m]", 2),
        "control_falls": ("falls without a push", 1),
        "frames_per_s": ("frames/s", 0),
    }
    needs_training_size: ClassVar[bool] = True

    plan = staticmethod(grid)
    pushes = staticmethod(single_pushes)
    summary = staticmethod(summarize)

    def check(self, battery: Battery) -> None:
        """One push point and duration, and no random or listed pushes."""
        check_unused(battery, "resolution", "interval", "forces", "commands")
        check_single(battery, "duration", "point")

    def columns(self, pushes: Pushes, outcomes: Outcomes) -> Mapping[str, NDArray[np.generic]]:
        """None."""
        return {}

    def background(self, battery: Battery) -> Battery | None:
        """Five starts: enough to draw ``pose_hold`` behind the policy."""
        return replace(battery, starts=min(battery.starts, 5))

    def write(self, result: Result, folder: Path) -> Written:
        """The map of success over ``pose_hold``, and the strategies by side and size."""
        summary, lines = result.summary, result.lines
        title = result.heading(_count(result.trials))
        files = write_figures(
            folder,
            "success_map",
            lambda path: success_map(
                result.trials, path, title=title, baseline=result.background, lines=lines
            ),
        )
        files += write_table(folder, "strategies", strategy_table(result.trials))
        headline = (
            f"I50 mean {summary['i50_mean']:.3f}{error_of(summary)}, "
            f"least {summary['i50_min']:.2f}; I90 mean {summary['i90_mean']:.3f}"
        )
        return Written(files, [success_by_size({result.name: summary}), headline])

    def compare(self, results: Mapping[str, Result], folder: Path) -> Written:
        """I50 by direction of all, and in how many directions it is at least as large."""
        first = next(iter(results.values()))
        trials = {label: result.trials for label, result in results.items()}
        lines = first.lines
        counted = _count(first.trials)
        title = first.heading(counted, of="I50 by direction")
        files = write_figures(
            folder, "overlay", lambda path: overlay(trials, path, title=title, lines=lines)
        )
        above = first.heading(counted, of="Directions with at least an I50")
        files += write_figures(
            folder, "profiles", lambda path: profiles_plot(trials, path, title=above)
        )
        shown = success_by_size({label: result.summary for label, result in results.items()})
        return Written(files, [shown])

    def study_row(
        self, battery: Battery, trials: pd.DataFrame, training_size: str
    ) -> dict[str, float]:
        """``study_figures`` but for the speed; success is that at ``training_size``."""
        summary = summarize(battery, trials)
        mild = trials[trials["impulse"] == trials["impulse"][trials["impulse"] > 0].min()]
        return {
            "i50_mean": summary["i50_mean"],
            "i50_min": summary["i50_min"],
            "success": summary["success"][training_size],
            "target_smoothness": 1e3 * summary["target_smoothness"],
            "joint_torque_rms": float(mild["joint_torque_rms"].mean()),
            "control_falls": summary["control_falls"],
        }


def _count(trials: pd.DataFrame) -> str:
    return count(trials, ("direction_rad", "impulse"), "trials per direction and size")


def success_by_size(summaries: Mapping[str, dict[str, Any]]) -> Sheet:
    """Success by impulse and the headline figures, one column per policy."""
    first = next(iter(summaries.values()))
    duration = first["definition"]["duration"]
    title = f"{first['battery']}, {first['n']} trials each: share recovered, 95 % interval"
    sizes = [f"{key} ({first['force_n'][key]:.0f} N)" for key in first["success"]]
    of = "" if len(sizes) > 9 else f" (of {', '.join(first['success'])})"
    columns = {f"push I (N for {duration:g} s)": [*sizes, f"mean I50{of}", "falls without a push"]}
    for name, s in summaries.items():
        low, high = s["success_low"], s["success_high"]
        columns[name] = [
            f"{100 * share:3.0f} %  [{100 * low[key]:.0f}, {100 * high[key]:.0f}]"
            for key, share in s["success"].items()
        ]
        columns[name] += [f"{s['i50_mean']:.2f}", f"{s['control_falls']} of {s['control_n']}"]
    return Sheet(pd.DataFrame(columns), title)
