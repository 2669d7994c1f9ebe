"""The studies that ship: every table and figure comes out of the stored results as it is."""

import filecmp
import json
import shutil
from importlib.metadata import version
from pathlib import Path
from typing import NotRequired

import pytest
from omegaconf import OmegaConf
from rich.console import Console

from tests.shell import run
from zfall import migrations, static_checks
from zfall.configs import config_folder
from zfall.envs.transforms import windows
from zfall.moved import MOVED
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
        same = filecmp.cmp(
            results / f"{name}.{ending}", SHIPPED / f"{name}.{ending}", shallow=False
        )
        assert same, f"{name}.{ending}"
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
    from zfall.training.keys import TrainKeys

    class Later(TrainKeys):
        horizon: NotRequired[int]

    monkeypatch.setattr(checks, "TrainKeys", Later)
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
    renamed = [
        "experiment=quickstart_studied", "~optimizer.lr", "+optimizer.rate=5e-4",
        "~env.transforms.push.size", "+env.transforms.push.strength=[0.1,0.7]",
    ]  # fmt: skip
    names = {"lr": "rate", "size": "strength"}  # of the arguments of both classes
    of = static_checks.parameters_of
    monkeypatch.setattr(
        static_checks,
        "parameters_of",
        lambda called: {names.get(name, name): kind for name, kind in of(called).items()},
    )
    study = study_of("symmetry", base=renamed)
    assert len(without_table(results, study, tmp_path)) == len(study.plan)
    monkeypatch.setitem(migrations.RENAMED, "optimizer.lr", "rate")
    push = "zfall.envs.transforms.pushes.RandomPush"
    monkeypatch.setitem(migrations.RENAMED, f"{push}.size", "strength")
    assert without_table(results, study_of("symmetry", base=renamed), tmp_path) == []


def test_a_moved_class_orphans_nothing(results, tmp_path, monkeypatch):
    name = "+env.transforms.last_action._target_=zfall.envs.transforms.windows.Latest"
    base = ["experiment=quickstart_studied", f"+{name}"]
    monkeypatch.setattr(windows, "Latest", windows.LastAction, raising=False)
    assert without_table(results, study_of("symmetry", base=base), tmp_path)
    old, new = "zfall.envs.transforms.windows.LastAction", name.partition("=")[2]
    monkeypatch.setitem(MOVED, old, new)
    assert without_table(results, study_of("symmetry", base=base), tmp_path) == []


@pytest.mark.parametrize("name", ["../../evil", "/tmp/evil", "''", "a/b", "[x]", "3"])
def test_a_study_writes_nowhere_else(name, tmp_path):
    places = [f"results={tmp_path}/a/b", f"runs={tmp_path}/a/runs"]
    done = run("ablate", "study=symmetry", "rebuild=true", f"study.name={name}", *places)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: study.name must be the name of a file")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    assert not (tmp_path / "a" / "b").exists()


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
