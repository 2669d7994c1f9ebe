"""Strategies by the direction of a push, in the layout of Duburcq et al. 2022, table I."""

from typing import Any, ClassVar

import numpy as np
import pandas as pd
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.followers import Ended, Moment
from zfall.evaluation.strategies import AMOUNTS, beyond_usual

COLUMNS = ("forward", "backward", "diagonal", "side", "small")


class DirectionStrategies:
    """Adds ``strategies_by_direction`` to a summary; it follows nothing itself.

    The battery's measures must have ``Strategies`` as well, whose columns it sums up.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: HumanoidEnv):
        pass

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Nothing."""

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Nothing."""

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """No columns."""
        return {}

    @staticmethod
    def summary(trials: pd.DataFrame) -> dict[str, Any]:
        """The table of ``direction_table``."""
        return {"strategies_by_direction": direction_table(trials)}


def direction_table(trials: pd.DataFrame) -> pd.DataFrame:
    """Share of recovered trials that show more of a strategy than the robot does unpushed.

    Columns: pushes ``forward``, ``backward``, ``diagonal`` (neither along an axis) and to the
    ``side``, of all sizes but the smallest; ``small``, the smallest size from any direction. Rows:
    ``ankle`` (none of the others), the strategies of ``strategies.AMOUNTS``; then ``recovered``,
    the number of trials counted, and ``pushed``, of how many.

    Source: Duburcq et al., IROS 2022, table I, which judges by eye and has marks for shares.
    """
    pushed = trials[trials["impulse"] > 0]
    recovered = pushed[pushed["recovered"]].copy()
    for name, more in beyond_usual(trials, recovered).items():
        recovered[name] = more
    recovered["ankle"] = (recovered[list(AMOUNTS)].sum(axis=1) == 0).astype(float)
    names = ["ankle", *AMOUNTS]
    table = recovered.groupby(_columns(recovered, pushed))[names].mean().reindex(list(COLUMNS)).T
    for name, counted in (("recovered", recovered), ("pushed", pushed)):
        sizes = _columns(counted, pushed).value_counts()
        table.loc[name] = sizes.reindex(list(COLUMNS), fill_value=0).astype(float)
    return table.rename_axis("strategy").rename_axis(None, axis=1).reset_index()


def _columns(trials: pd.DataFrame, pushed: pd.DataFrame) -> pd.Series:
    """Which of ``COLUMNS`` each trial belongs to."""
    quarter = trials["direction_rad"].to_numpy() / (np.pi / 2)
    straight = np.abs(quarter - quarter.round()) < 1e-6
    axis = np.array(["forward", "side", "backward", "side"])[quarter.round().astype(int) % 4]
    column = np.where(straight, axis, "diagonal")
    small = trials["impulse"].to_numpy() == pushed["impulse"].min()
    return pd.Series(np.where(small, "small", column), index=trials.index)
