"""Kinds of batteries: how one is planned, run, summed up and drawn.

A battery's yaml names its kind by the dotted path of a class. ``Kind`` says what such a class has;
``planar.py`` is the one to begin a new kind from. There is nothing to inherit and nothing to
register.

A kind may also have a method ``prepare(battery, trials, env)``: it is called before each chunk of
trials, one for each world of ``env``, whose transforms it may set for the coming episode.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import pandas as pd

from zfall.errors import object_at

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from zfall.evaluation.definitions import Battery
    from zfall.evaluation.metrics import Outcomes
    from zfall.evaluation.plans import Pushes
    from zfall.evaluation.results import Result, Written

# Column of a table: its heading, and its digits.
Figures = Mapping[str, tuple[str, int]]


class Kind(Protocol):
    """What the class has that a battery names by ``kind``; it is made without arguments.

    Attributes:
        independent: whether one plan holds all trials, so that a trial can be run alone and those
            of several policies compare one by one. If not, ``run`` chooses them as it goes.
        baseline_task: the env of ``recipes/env`` of baselines if none is given.
        study_figures: by its key, heading and digits of each column of a study's table.
        needs_training_size: whether a study must name one of the impulses as ``training_size``.
    """

    independent: ClassVar[bool]
    baseline_task: ClassVar[str]
    study_figures: ClassVar[Figures]
    needs_training_size: ClassVar[bool]

    def check(self, battery: "Battery") -> None:
        """Refuses numbers that make no battery of this kind; raises ``ValueError``."""

    def plan(self, battery: "Battery", impulse_unit: float, seed: int) -> pd.DataFrame:
        """The trials, one a row, with the columns of ``plans.plan_trials``."""

    def pushes(self, battery: "Battery", trials: pd.DataFrame) -> "Pushes":
        """What pushes each of these trials."""

    def columns(
        self, pushes: "Pushes", outcomes: "Outcomes"
    ) -> Mapping[str, "NDArray[np.generic]"]:
        """Columns ``(K,)`` for K trials, after those of ``measures``.

        Args:
            pushes: of the K trials.
            outcomes: of their worlds, and perhaps more.
        """

    def run(
        self, battery: "Battery", trials: pd.DataFrame, run: Callable[[pd.DataFrame], pd.DataFrame]
    ) -> pd.DataFrame:
        """All trials with their outcomes, of a kind whose trials are not ``independent``.

        Args:
            battery: the definition.
            trials: all of ``plan``.
            run: runs a plan and returns it with the outcomes; a plan that an interrupted call
                finished is read, so the same outcomes must lead to the same next plan.
        """

    def background(self, battery: "Battery") -> "Battery | None":
        """The battery that ``pose_hold`` is put to, to be drawn with a policy; ``None``: none."""

    def summary(self, battery: "Battery", trials: pd.DataFrame) -> dict[str, Any]:
        """What ``summary.json`` says; begins with ``statistics.head``."""

    def write(self, result: "Result", folder: Path) -> "Written":
        """Writes tables and figures of a policy's result.

        Args:
            result: the trials and their summary.
            folder: where to; its name says battery and setting.
        """

    def compare(self, results: Mapping[str, "Result"], folder: Path) -> "Written":
        """Writes tables and figures of several policies, by their labels, on the same trials.

        ``comparison.csv`` is written for every kind.
        """

    def study_row(
        self, battery: "Battery", trials: pd.DataFrame, training_size: str
    ) -> dict[str, float]:
        """The values of ``study_figures`` for one trained policy, NaN where nothing is to count.

        Those of the training itself, ``frames_per_s``, are added by the study.

        Args:
            battery: the definition.
            trials: with their outcomes.
            training_size: impulse of which training's pushes are, as a key of ``success``; empty
                where none is needed.
        """


def kind_of(battery: "Battery") -> Kind:
    """The kind of a battery.

    Raises:
        ValueError: if its path leads nowhere, or to no class.
    """
    made = object_at(battery.kind, "battery.kind")
    if not isinstance(made, type):
        raise ValueError(f"battery.kind must name a class, got {battery.kind}.")
    kind: Kind = made()
    return kind
