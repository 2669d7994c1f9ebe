"""What was drawn of physics and hardware in each trial, and what of it explains failures."""

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import torch
from scipy.stats import chi2_contingency
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.followers import Ended, Moment
from zfall.evaluation.plots import thirds_plot
from zfall.evaluation.writers import write_figures

PARTS = ("low", "middle", "high")  # thirds of the trials, by the value of a parameter
COLUMN = "drawn/"


class Draws:
    """Keeps the physical parameters that a trial begins with.

    ``drawn/NAME``: each entry of ``("params", NAME)``, in its unit; of several numbers, one for
    each joint or link, the root mean square.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: HumanoidEnv):
        self._drawn: dict[str, Tensor] | None = None

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in the first control step."""
        self.update(td, now)

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in the first control step."""
        if self._drawn is None:
            params = td.get("params", None)
            there = {} if params is None else dict(params.items())
            self._drawn = {str(name): _size(value) for name, value in sorted(there.items())}

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Columns ``(N,)``."""
        return {COLUMN + name: value for name, value in (self._drawn or {}).items()}

    @staticmethod
    def summary(trials: pd.DataFrame) -> dict[str, Any]:
        """``draws``, the table of ``success_by_draw``; nothing where nothing is drawn."""
        table = success_by_draw(trials)
        return {"draws": table} if len(table) else {}

    @staticmethod
    def figures(trials: pd.DataFrame, folder: Path, title: str) -> list[str]:
        """``draws``, the same table as a plot."""
        table = success_by_draw(trials)
        if not len(table):
            return []
        return write_figures(folder, "draws", lambda path: thirds_plot(table, path, title=title))


def success_by_draw(trials: pd.DataFrame) -> pd.DataFrame:
    """Success of pushed trials by thirds of each drawn parameter.

    One row per ``parameter``: its smallest and largest value, ``smallest`` and ``largest``; the
    share recovered in the thirds of the trials with the ``low``, ``middle`` and ``high`` values;
    ``p`` of a chi-squared test that the thirds do not differ. The smallest p comes first. Of many
    parameters that explain nothing, one in twenty has a p below 0.05. A third is empty, and its
    share NaN, where many trials have the same value: delays are whole physics steps. ``n_low``,
    ``n_middle``, ``n_high``: how many trials each has.
    """
    pushed, rows = trials[trials["impulse"] > 0], []
    for name in [name for name in map(str, trials) if name.startswith(COLUMN)]:
        drawn, recovered = pushed[name].to_numpy(), pushed["recovered"].to_numpy(bool)
        if not len(drawn) or drawn.min() == drawn.max():
            continue
        ranks = pushed[name].rank().to_numpy()  # equal values share theirs
        part = (len(PARTS) * (ranks - 0.5) / len(drawn)).astype(int)
        good = np.array([recovered[part == third].sum() for third in range(len(PARTS))])
        of = np.array([(part == third).sum() for third in range(len(PARTS))])
        rows.append(
            {
                "parameter": name.removeprefix(COLUMN),
                "smallest": float(drawn.min()),
                "largest": float(drawn.max()),
                **dict(zip(PARTS, _shares(good, of), strict=True)),
                "p": _chance(good, of),
                **{f"n_{third}": int(n) for third, n in zip(PARTS, of, strict=True)},
            }
        )
    table = pd.DataFrame(rows)
    return table.sort_values("p", ignore_index=True) if len(table) else table


def _size(value: Tensor) -> Tensor:
    """One number ``(N,)`` of values ``(N, size)``."""
    if value.shape[-1] == 1:
        return value[:, 0].clone()
    return value.double().square().mean(-1).sqrt().to(torch.float32)


def _shares(good: np.ndarray, of: np.ndarray) -> list[float]:
    return [float(g / n) if n else float("nan") for g, n in zip(good, of, strict=True)]


def _chance(good: np.ndarray, of: np.ndarray) -> float:
    """p of a test that shares do not differ; 1 if all or none succeed."""
    used = of > 0
    counts = np.stack([good, of - good])[:, used]
    if (counts.sum(1) == 0).any():
        return 1.0
    return float(chi2_contingency(counts).pvalue)
