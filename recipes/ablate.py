"""Runs a study and makes its table: ``python -m recipes.ablate study=termination``.

A study is a yaml: a base, rows of overrides, seeds, a battery, a budget. What is finished is not
run again, what was cut goes on, a run that fails is marked and the others go on.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import hydra
from omegaconf import DictConfig

from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Name, Whole

from .shell import check_recipe, one_line_errors, start

if TYPE_CHECKING:
    from zfall.studies import Study


class Keys(TypedDict):
    """The keys of ``ablate.yaml``."""

    study: Mapping[str, Any]
    results: Name
    runs: Name
    rebuild: bool
    force: bool
    launcher: Name
    launch: Mapping[Name, Any] | None
    jobs: Whole | None
    trust: Sequence[Name]


@hydra.main(version_base=None, config_path=".", config_name="ablate")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Runs what is missing and writes ``NAME.{md,csv,tex,png,pdf}`` into ``results``."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    with one_line_errors(), trusting(cfg.trust):
        study = checked(cfg)
        plan = study.plan
    with one_line_errors(SPOKEN), trusting(cfg.trust):
        from rich.console import Console

        from zfall.studies.execute import execute
        from zfall.studies.launch import sweep
        from zfall.studies.store import Store
        from zfall.studies.writers import print_tables

        results, runs = Path(cfg.results), Path(cfg.runs)
        if cfg.jobs is not None:  # in a launcher's process
            if cfg.jobs >= len(plan):
                raise ValueError(f"jobs must be below {len(plan)}, the runs, got {cfg.jobs}.")
            execute(study, plan[int(cfg.jobs)], Store(results, runs))
            return
        submit = None
        if cfg.launcher != "basic":
            log = runs / f"{study.name}.log"
            where = {"launcher": cfg.launcher, "launch": cfg.launch, "log": log}
            submit = partial(sweep, "jobs", module=f"{__package__}.ablate", **where)
        how = {"rebuild": cfg.rebuild, "force": cfg.force, "submit": submit}
        study.run(results=results, runs=runs, **how)
        print_tables(study, Store(results, runs), Console())


def checked(cfg: DictConfig) -> "Study":
    """The study of a config of this recipe.

    Raises:
        ValueError: on a bad value, naming the key.
    """
    check_recipe(cfg, Keys)
    from zfall.studies import Study

    return Study.from_config(cfg.study)


if __name__ == "__main__":
    start(main)
