"""Runs a study and makes its table: ``python -m recipes.ablate study=termination``.

A study is a yaml: a base, rows of overrides, seeds, a battery, a budget. What is finished is not
run again, what was cut goes on, a run that fails is marked and the others go on.
"""

from functools import partial
from pathlib import Path

import hydra
from omegaconf import DictConfig

from zfall.errors import check_flags, check_keys
from zfall.studies import Study
from zfall.studies.execute import execute
from zfall.studies.launch import sweep
from zfall.studies.store import Store
from zfall.trust import trusting

from .shell import one_line_errors, start

KEYS = {"study", "results", "runs", "rebuild", "force", "launcher", "jobs", "trust"}


@hydra.main(version_base=None, config_path=".", config_name="ablate")
def main(cfg: DictConfig) -> None:
    """Runs what is missing and writes ``NAME.{md,csv,tex,png,pdf}`` into ``results``."""
    with one_line_errors(), trusting(cfg.trust):
        study = checked(cfg)
        plan = study.plan
        results, runs = Path(cfg.results), Path(cfg.runs)
        if cfg.jobs is not None:  # in a launcher's process
            execute(study, plan[int(cfg.jobs)], Store(results, runs))
            return
        submit = None
        if cfg.launcher != "basic":
            log = runs / f"{study.name}.log"
            submit = partial(sweep, module=f"{__package__}.ablate", launcher=cfg.launcher, log=log)
        how = {"rebuild": cfg.rebuild, "force": cfg.force, "submit": submit}
        study.run(results=results, runs=runs, **how)
        print((results / f"{study.name}.md").read_text())


def checked(cfg: DictConfig) -> Study:
    """The study of a config of this recipe.

    Raises:
        ValueError: on a bad value, naming the key.
    """
    check_keys(cfg, KEYS)
    check_flags(cfg, ["rebuild", "force"])
    for key in ("results", "runs"):
        if not isinstance(cfg[key], str):
            raise ValueError(f"{key} must be the name of a folder, got {cfg[key]}.")
    return Study.from_config(cfg.study)


if __name__ == "__main__":
    start(main)
