"""Where the results and the run folders of studies lie, and what names them.

Files are named by digests of all that they follow from, so that studies share them.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

import pandas as pd
from omegaconf import DictConfig, OmegaConf

from zfall.envs.tables import env_digest
from zfall.errors import in_one_line
from zfall.fingerprints import digest, file_digest
from zfall.policies.load import checkpoint_of

if TYPE_CHECKING:
    from zfall.studies.plan import Run, Test


@dataclass(frozen=True)
class Store:
    """The two folders of a study, which others may share.

    Args:
        results: of the tables, with a csv for each finished test.
        runs: of the run folders.
    """

    results: Path
    runs: Path

    @property
    def results_of_runs(self) -> Path:
        """Where the csv files of finished tests lie."""
        return self.results / "runs"

    def result(self, test: "Test") -> Path:
        """The file with the figures of a finished test."""
        return self.results_of_runs / f"{test.name}.csv"

    def curve(self, test: "Test") -> Path:
        """The file with the learning curve of what was tested."""
        return self.results_of_runs / f"{test.name}_curve.csv"

    def failure(self, test: "Test") -> Path:
        """The file that says why a test has no figures."""
        return self.runs / f"{test.name}.failed"

    def run_folder(self, cfg: DictConfig) -> Path:
        """Where a training of this config lies, whatever study or row it is for."""
        return self.runs / training_digest(cfg)

    def unfinished(self, run: "Run") -> list["Test"]:
        """Tests of a run that have no figures."""
        return [test for test in run.tests if not self.result(test).exists()]

    def write(self, test: "Test", row: dict[str, object], curve: pd.DataFrame) -> None:
        """Writes the figures of a finished test, and its learning curve."""
        curve.to_csv(self.curve(test), index=False)
        path = self.result(test)
        temporary = path.with_suffix(f".{os.getpid()}.tmp")  # another study may write the same
        pd.DataFrame([row]).to_csv(temporary, index=False)
        temporary.replace(path)
        self.failure(test).unlink(missing_ok=True)

    def mark_failed(self, test: "Test", error: Exception) -> None:
        """Writes down why a test has no figures."""
        self.runs.mkdir(parents=True, exist_ok=True)
        self.failure(test).write_text(in_one_line(error))

    def why_missing(self, test: "Test") -> str:
        """What stands in the place of figures that are not there."""
        why = self.failure(test)
        return f"failed: {shorten(why.read_text(), 100)}" if why.exists() else "not run"


def training_digest(cfg: DictConfig) -> str:
    """Tells a training from all others."""
    config = cfg.copy()
    OmegaConf.set_struct(config, False)
    for key in ("groups", "name", "logger"):  # they change no result; of groups, random numbers
        config.pop(key, None)
    wanted = {"config": OmegaConf.to_yaml(config, resolve=True), "env": env_digest(cfg.env)}
    if cfg.warm_start is not None:
        wanted["warm_start"] = file_digest(checkpoint_of(cfg.warm_start, key="warm_start"))
    losses = (cfg.get("auxiliary_losses") or {}).items()
    teachers = {name: loss.teacher for name, loss in losses if "teacher" in loss}
    if teachers:
        paths = [
            checkpoint_of(str(run), key=f"auxiliary_losses.{name}.teacher")
            for name, run in teachers.items()
        ]
        wanted["teachers"] = " ".join(map(file_digest, paths))
    return digest(wanted)
