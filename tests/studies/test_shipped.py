"""The studies that ship: every table and figure comes out of the stored results as it is."""

import json
import shutil
from importlib.metadata import version
from pathlib import Path

import pytest
from omegaconf import OmegaConf
from rich.console import Console

from tests.shell import run
from zfall import migrations
from zfall.configs import config_folder
from zfall.studies import Study
from zfall.studies.store import Store

SHIPPED = Path(__file__).parents[2] / "docs" / "studies"
NAMES = sorted(path.stem for path in (config_folder() / "study").glob("*.yaml"))
QUIET = Console(quiet=True)


def study_of(name: str, **changes) -> Study:
    table = OmegaConf.load(config_folder() / "study" / f"{name}.yaml")
    return Study.from_config(OmegaConf.merge(table, changes))


@pytest.fixture
def results(tmp_path) -> Path:
    """The stored results, without the tables."""
    shutil.copytree(SHIPPED / "results", tmp_path / "studies" / "results")
    return tmp_path / "studies"


@pytest.mark.parametrize("name", NAMES)
def test_a_study_is_rebuilt_byte_for_byte(name, results, tmp_path):
    """Figures depend on the version of matplotlib, which writes it into them."""
    study_of(name).run(results=results, runs=tmp_path / "runs", rebuild=True, console=QUIET)
    drawn = f"Matplotlib version{version('matplotlib')}," in (
        (SHIPPED / f"{name}.png").read_bytes()[:300].decode("latin1")
    )
    for ending in ("md", "tex", "csv", *(("png", "pdf") if drawn else ())):
        built = (results / f"{name}.{ending}").read_bytes()
        assert built == (SHIPPED / f"{name}.{ending}").read_bytes(), ending
    assert not (tmp_path / "runs").exists()


def test_nothing_else_is_stored_than_what_studies_show():
    stored = {path.stem for path in (SHIPPED / "results").glob("*.jsonl")}
    assert stored == {path.stem for path in SHIPPED.glob("*.md")} == set(NAMES)


def test_a_stored_result_has_its_config_and_its_versions():
    packages = {"zfall", "torch", "torchrl", "tensordict", "mujoco", "numpy"}
    for path in (SHIPPED / "results").glob("*.jsonl"):
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        configs = {
            line["id"]: line["training"] for line in lines if "training" in line and "id" in line
        }
        for line in lines:
            if "result" in line:
                assert configs[line["training"]]["config"]["seed"] == line["seed"]
                assert packages | {"commit"} <= set(line["versions"])


def without_table(results: Path, study: Study, tmp_path: Path) -> list[str]:
    store = Store(results, tmp_path / "runs")
    return [f"{run.row}: {test.title}" for run in study.plan for test in store.unfinished(run)]


def test_a_new_key_of_every_training_orphans_nothing(results, tmp_path, monkeypatch):
    """With one line in the table. Without it no result is found, and the key is named."""
    from zfall.training import checks

    monkeypatch.setattr(checks, "KEYS", checks.KEYS | {"horizon"})
    study = study_of("symmetry", base=["experiment=quickstart_studied", "+horizon=3"])
    assert len(without_table(results, study, tmp_path)) == len(study.plan)
    nearest = Store(results, tmp_path / "runs").nearest(study.plan[0].tests[0])
    assert "differs in horizon (nothing stored, 3 wanted)" in nearest
    monkeypatch.setitem(migrations.MISSING, "horizon", 3)
    again = study_of("symmetry", base=["experiment=quickstart_studied", "+horizon=3"])
    assert without_table(results, again, tmp_path) == []


def test_a_new_argument_that_is_the_default_of_its_class_orphans_nothing(results, tmp_path):
    given = ["experiment=quickstart_studied", "+optimizer.weight_decay=0", "+optimizer.eps=1e-8"]
    assert without_table(results, study_of("symmetry", base=given), tmp_path) == []
    given[1] = "+optimizer.weight_decay=0.01"
    assert without_table(results, study_of("symmetry", base=given), tmp_path)


def test_a_renamed_key_orphans_nothing(results, tmp_path, monkeypatch):
    renamed = ["experiment=quickstart_studied", "~env.transforms.noise"]
    noise = "{_target_: zfall.envs.transforms.observations.ObservationNoise, std: {joint_position: 0.01, joint_velocity: 0.2, base_angular_velocity: 0.02, projected_gravity: 0.01}, before: observation}"
    renamed += [f"+env.transforms.sensors={noise}", "~env.training_only.noise", "+env.training_only.sensors=true"]  # fmt: skip
    study = study_of("symmetry", base=renamed)
    assert without_table(results, study, tmp_path)
    key = "env.transforms.noise"
    for old, new in ((key, "sensors"), ("env.training_only.noise", "sensors")):
        monkeypatch.setitem(migrations.RENAMED, old, new)
    missing = Store(results, tmp_path / "runs").nearest(
        study_of("symmetry", base=renamed).plan[0].tests[0]
    )
    assert "noise" not in missing.partition("differs in")[2].replace("ObservationNoise", "")


def test_a_table_that_would_lose_runs_is_refused_and_stays(tmp_path):
    shutil.copytree(SHIPPED, tmp_path / "studies")
    before = {path: path.read_bytes() for path in (tmp_path / "studies").glob("symmetry.*")}
    (tmp_path / "studies" / "results" / "symmetry.jsonl").unlink()
    args = ["study=symmetry", "rebuild=true", f"results={tmp_path}/studies", f"runs={tmp_path}/r"]
    done = run("ablate", *args)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "symmetry.csv must keep its 6 finished runs" in line
    assert "force=true" in line
    assert "augmentation._target_ (nothing stored, " in line
    assert "wrote" not in done.stdout
    assert {path: path.read_bytes() for path in before} == before
    done = run("ablate", *args, "force=true")
    assert done.returncode == 0, done.stderr
    assert "not run" in (tmp_path / "studies" / "symmetry.md").read_text()
