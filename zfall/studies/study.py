"""A study: rows that differ in one thing, trained with several seeds, tested in one battery."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, MISSING, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from zfall.errors import check_keys
from zfall.studies.checks import check_values
from zfall.studies.execute import execute
from zfall.studies.launch import progress_of
from zfall.studies.plan import Run, plan, shown
from zfall.studies.store import Store
from zfall.studies.writers import write_tables


@dataclass(frozen=True)
class Study:
    """Trains what is missing, tests it, and compares the rows with the first one.

    A study of a few seconds, far too short to learn anything::

        from zfall.studies import Study

        study = Study(
            "symmetry",
            base=["experiment=quickstart", "num_envs=8"],
            rows={"none": [], "loss": ["symmetry=loss"]},
            seeds=[0, 1],
            total_frames=1024,
            battery={"name": "planar", "starts": 1, "directions": 4, "impulses": [0.2, 0.4]},
            training_size=0.4,
        )
        table = study.run(results="results", runs="runs/studies")

    The yaml files of ``recipes/study`` have the same keys.

    Args:
        name: of its files.
        base: overrides of ``recipes.train`` that all rows share.
        rows: by name, the overrides of each; the first is the one to compare with.
        seeds: of the trainings of each row.
        total_frames: of each training.
        battery: its ``name`` and options.
        training_size: for a battery whose table shows the success at one impulse, that impulse.
        row_seeds: by row, seeds in place of ``seeds``.
        tests: by title, overrides of ``base`` that give the world of a test, or ``None`` for the
            world of each training without its ``training_only``, which is also the default.
        tested_with: by row, a table with the ``_target_`` of a ``TestedWith``.

    Raises:
        ValueError: if a value is not of the kind that it should be.
    """

    name: str
    _: KW_ONLY
    base: Sequence[str]
    rows: Mapping[str, Sequence[str]]
    seeds: Sequence[int]
    total_frames: int
    battery: Mapping[str, Any]
    training_size: float | str | None = None
    row_seeds: Mapping[str, Sequence[int]] = field(default_factory=dict)
    tests: Mapping[str, Sequence[str] | None] = field(default_factory=dict)
    tested_with: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_values({each.name: getattr(self, each.name) for each in fields(self)})

    @classmethod
    def from_config(cls, config: DictConfig) -> "Study":
        """From the yaml of a study.

        Raises:
            ValueError: if a key is missing or unknown, or a value is not of its kind.
        """
        own = fields(cls)
        check_keys(config, {each.name for each in own}, "study.")
        needed = [each.name for each in own if each.default is each.default_factory is MISSING]
        missing = [key for key in needed if OmegaConf.select(config, key) is None]
        if missing:
            raise ValueError(
                f"study.{missing[0]} must be given, as a study has {', '.join(needed)}; got null."
            )
        values = OmegaConf.to_container(config, resolve=True)
        assert isinstance(values, dict)
        return cls(**{str(key): value for key, value in values.items() if value is not None})

    @cached_property
    def plan(self) -> list[Run]:
        """All its runs, every config composed and checked.

        Raises:
            ValueError: naming the key of the study that is wrong.
        """
        return plan(self)

    def run(
        self,
        *,
        results: str | Path = "docs/studies",
        runs: str | Path = "runs/studies",
        rebuild: bool = False,
        force: bool = False,
        console: Console | None = None,
        submit: Callable[[Sequence[int]], None] | None = None,
    ) -> pd.DataFrame:
        """Runs what has no results yet and writes ``NAME.{md,csv,tex,png,pdf}``.

        What was cut goes on. A run that fails is marked in the tables, and the others go on.
        Learning curves are drawn as soon as there is one.

        Args:
            results: folder of the tables, and of ``results/NAME.jsonl`` with what is finished.
            runs: folder of the run folders.
            rebuild: whether only to make the tables, from what is finished.
            force: whether a table may have fewer finished runs than the one that it replaces.
            console: shows the progress.
            submit: has runs of ``plan``, given by their positions, executed in other processes;
                without it they are executed here, one after the other.

        Returns:
            A line for each row and figure, as in ``NAME.csv``: ``mean`` over seeds, ``low`` and
            ``high`` of its bootstrap 95 % interval, and the paired ``difference`` to the first
            row, and ``seeds``, how many these are; with a column ``test`` if there are several
            worlds.

        Raises:
            ValueError: if a table would lose finished runs, naming what is missing and why.
        """
        plan, store = self.plan, Store(Path(results), Path(runs))
        console = console or Console()
        todo = [i for i, run in enumerate(plan) if store.unfinished(run)]
        if todo and not rebuild:
            first = plan[todo[0]]
            test = store.unfinished(first)[0]
            line = f"{len(todo)} of {len(plan)} runs are not stored; of {shown(first, test)}, "
            console.print(line + store.nearest(test), markup=False, soft_wrap=True)
            with progress_of(self, store, console):
                if submit is not None:
                    submit(todo)
                else:
                    for number in todo:
                        execute(self, plan[number], store)
        frame, paths = write_tables(self, store, force=force)
        written = ", ".join(map(str, paths))
        console.print(f"wrote {written}", markup=False, highlight=False, soft_wrap=True)
        return frame
