"""Studies: what is finished stays, what was cut goes on, what fails is marked."""

import multiprocessing
import sys
import time
from pathlib import Path
from typing import ClassVar

import pandas as pd
import pytest
import torch
import yaml
from hydra import compose, initialize_config_module
from hydra.utils import instantiate
from omegaconf import OmegaConf
from rich.progress import Progress
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from recipes import study_plan, study_runs
from recipes.ablate import follow
from tests.shell import run
from zfall import checkpoint
from zfall.evaluation.battery import battery_env
from zfall.studies.plan import Run, Test, battery_of, in_test, plan
from zfall.training.run_folder import VERSION

STUDY = """
name: tiny
base: [experiment=quickstart, num_envs=16, rollout_steps=4, checkpoint_every=1]
rows: {none: [], mirrored: [symmetry=augmentation], bad: [env.transforms.push.point=toe]}
seeds: [0, 1]
total_frames: 256
battery: {name: planar, starts: 1, impulses: [0.1, 0.4], directions: 2, end_time: 3.4}
training_size: "0.4"
"""
OTHER = (
    STUDY.replace("name: tiny", "name: other")
    .replace("none: []", "plain: []")
    .replace(", mirrored: [symmetry=augmentation], bad: [env.transforms.push.point=toe]", "")
)
KNEELING = """
name: falls
base: [num_envs=16, rollout_steps=4]
rows:
  two: [experiment=push_to_kneel_kneel]
  one: [experiment=push_to_kneel]
  script: [experiment=push_to_kneel_recover]
beside: {two: {recover: [experiment=push_to_kneel_recover, num_envs=16, rollout_steps=4]}, script: {kneel: script}}
tests: {tilt: [experiment=push_to_kneel], late: [experiment=push_to_kneel, env.transforms.mode.angle=1.2]}
seeds: [0]
total_frames: 64
battery: {name: kneel, starts: 1, force_starts: 1, impulses: [1.5], directions: 1, forces: [[20, 0]], end_time: 1.5}
"""


@pytest.fixture
def studies(tmp_path) -> list[str]:
    own = tmp_path / "own" / "study"
    own.mkdir(parents=True)
    (own / "tiny.yaml").write_text(STUDY)
    (own / "other.yaml").write_text(OTHER)
    (own / "falls.yaml").write_text(KNEELING)
    return ["--config-dir", str(own.parent), f"results={tmp_path}/results", f"runs={tmp_path}/runs"]


def without_speed(folder: Path, name: str) -> list[str]:
    text = (folder / "results" / f"{name}.csv").read_text().splitlines()
    return [line for line in text if "frames_per_s" not in line]


def ablate(args: list[str]) -> None:
    """``python -m recipes.ablate ARGS`` in a process of its own."""
    import torch

    from recipes import ablate as recipe
    from zfall.errors import start

    torch.set_num_threads(1)
    sys.argv = ["recipes/ablate.py", *args]
    start(recipe.main)


def test_a_study_marks_what_failed_and_runs_what_is_shared_once(studies, tmp_path):
    done = run("ablate", *studies, "study=tiny")
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "results" / "tiny.md").read_text()
    assert "| none |" in text
    assert "| bad, seed 1 | failed: env.transforms.push: point must be" in text
    for ending in ("csv", "tex", "png", "pdf"):
        assert (tmp_path / "results" / f"tiny.{ending}").exists()
    files = set((tmp_path / "results" / "runs").glob("*.csv"))
    assert len(files) == 2 * 4  # two rows, two seeds; figures and a curve
    figures = pd.read_csv(tmp_path / "results" / "tiny.csv")
    assert set(figures["row"]) == {"none", "mirrored"}
    times = {path: path.stat().st_mtime_ns for path in files}
    done = run("ablate", *studies, "study=other")  # its only row is a row of the first
    assert done.returncode == 0, done.stderr
    assert {path: path.stat().st_mtime_ns for path in files} == times
    assert set((tmp_path / "results" / "runs").glob("*.csv")) == files
    before = without_speed(tmp_path, "tiny")
    assert run("ablate", *studies, "study=tiny", "rebuild=true").returncode == 0
    assert without_speed(tmp_path, "tiny") == before


def test_a_study_killed_and_started_again_gives_the_same_table(studies, tmp_path):
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["recipes.ablate"])
    alone = [*studies[:2], f"results={tmp_path}/alone/results", f"runs={tmp_path}/alone/runs"]
    path = tmp_path / "own" / "study" / "tiny.yaml"
    path.write_text(STUDY.replace("seeds: [0, 1]", "seeds: [0]"))
    for args, kills in ((alone, 0), (studies, 1)):
        for kill in range(kills + 1):
            process = context.Process(target=ablate, args=([*args, "study=tiny"],))
            process.start()
            if kill < kills:
                root = Path(args[3].removeprefix("runs="))
                written = 0
                while process.is_alive() and written < 2 + 3 * kill:  # updates of all runs so far
                    texts = [p.read_text() for p in root.glob("*/metrics.csv")]
                    written = sum(max(0, text.count("\n") - 1) for text in texts)
                    time.sleep(0.01)
                assert process.is_alive()
                process.kill()
            process.join()
        assert process.exitcode == 0
    assert without_speed(tmp_path, "tiny") == without_speed(tmp_path / "alone", "tiny")


def test_rows_that_are_the_same_are_refused(studies, tmp_path):
    path = tmp_path / "own" / "study" / "tiny.yaml"
    path.write_text(STUDY.replace("[symmetry=augmentation]", "[symmetry=none]"))
    done = run("ablate", *studies, "study=tiny")
    assert done.returncode != 0
    assert "rows must differ, mirrored (seed 0) and none (seed 0) are the same" in done.stderr


def test_two_policies_are_trained_once_and_tested_in_each_world(studies, tmp_path):
    """The one that recovers stands in two rows."""
    done = run("ablate", *studies, "study=falls")
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "results" / "falls.md").read_text()
    assert "failed" not in text, text
    assert text.index("Tested: tilt") < text.index("| two |") < text.index("Tested: late")
    folders = list((tmp_path / "runs").glob("*/checkpoints"))
    assert len(folders) == 3
    figures = pd.read_csv(tmp_path / "results" / "falls.csv")
    assert set(figures["test"]) == {"tilt", "late"}
    assert set(figures["row"]) == {"two", "one", "script"}


def test_the_bar_follows_files_and_reads_no_config(tmp_path):
    """One run is finished, its folder gone; one has trained 1.2 million of 2; configs are none."""
    runs = [Run("row", seed, None, None, (Test("", None, f"t{seed}"),)) for seed in (0, 1)]
    folders, results = [[tmp_path / "a"], [tmp_path / "b"]], tmp_path / "results"
    for path, text in (
        (study_runs.result_file(results, runs[0].tests[0]), ""),
        (tmp_path / "b" / "metrics.csv", "update,frames\n1,1200000\n"),
    ):
        path.parent.mkdir(parents=True)
        path.write_text(text)

    class Twice:
        waits: ClassVar = [False, True]

        def wait(self, seconds: float) -> bool:
            return self.waits.pop(0)

    with Progress(disable=True) as bar:
        follow(
            bar,
            runs,
            folders,
            {tmp_path / "a": 1_000_000, tmp_path / "b": 2_000_000},
            results,
            Twice(),
        )
        (task,) = bar.tasks
    assert (task.completed, task.total) == (2.2, 3.0)


def test_worlds_are_the_rows_of_a_study_with_one_row(studies, tmp_path):
    path = tmp_path / "own" / "study" / "falls.yaml"
    rows = "rows: {script: [experiment=push_to_kneel_recover]}\nbeside: {script: {kneel: script}}\n"
    path.write_text(
        KNEELING[: KNEELING.index("rows:")] + rows + KNEELING[KNEELING.index("tests:") :]
    )
    done = run("ablate", *studies, "study=falls", "rebuild=true")
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "results" / "falls.md").read_text()
    assert "| tilt, seed 0 | not run |" in text
    assert "| late, seed 0 | not run |" in text


def test_a_world_takes_what_the_policy_sees_and_does_and_nothing_else():
    """Twice as many control steps, another range of the action; noise as in the test."""
    own = [
        "env.base_env.control_dt=0.02",
        "env.transforms.action.scale=0.3",
        "env.transforms.noise.std.joint_position=0.5",
    ]
    study = OmegaConf.create(
        yaml.safe_load(STUDY)
        | {"rows": {"own": own}, "tests": {"noisy": ["env.training_only.noise=false"]}}
    )
    with initialize_config_module("recipes", version_base=None):
        (one, _) = plan(study)
    env_cfg = in_test(one.tests[0], one.cfg.env)
    assert env_cfg.base_env.control_dt == 0.02
    assert env_cfg.transforms.action.scale == 0.3
    assert env_cfg.transforms.noise.std.joint_position == 0.01
    assert env_cfg.training_only.noise is False


@pytest.mark.parametrize(
    "beside", [{"recover": "script"}, {"walk": "best"}, {"recover": "best", "kneel": "script"}]
)
def test_what_no_policy_can_stand_beside_is_refused(beside):
    study = OmegaConf.create(yaml.safe_load(STUDY) | {"beside": {"mirrored": beside}})
    with (
        initialize_config_module("recipes", version_base=None),
        pytest.raises(ValueError, match="study.beside must give mirrored one policy"),
    ):
        plan(study)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"training_size": "0.45"}, "study.training_size must be one of 0.1, 0.4, got 0.45"),
        ({"name": None}, "study.name is missing: a study has name, base, rows, seeds"),
        ({"seeds": [0, 0]}, r"none \(seed 0\) and none \(seed 0\) are the same"),
        (
            {"tests": {"a": None, "b": None}},
            r"none \(seed 0, b\) and none \(seed 0, a\) are the same",
        ),
        ({"battery": {"name": "planar", "start": 1}}, "options of battery planar are .* got start"),
        ({"beside": {"none": "best"}}, "study.beside must give none one policy"),
        ({"rows": {}}, "study.rows must be at least one NAME"),
        ({"rows": {"a": "symmetry=loss"}}, "study.rows.a must be a list, got symmetry=loss"),
        (
            {"rows": {"a": ["+minibatch=7"]}},
            r"study.rows.a: minibatch is not a key .*minibatches\?",
        ),
        ({"rows": {"a": ["+loss.clip=1"]}}, "study.rows.a: loss.clip is not a key of the config"),
        ({"rows": {"a": ["num_envs=0"]}}, "study.rows.a: num_envs must be at least 1, got 0"),
        ({"rows": {"a": ["seed=5"]}}, "study.rows.a: seed must be left to seeds"),
        ({"rows": {"a": ["resume=x"]}}, "study.rows.a: resume must be null"),
        ({"rows": {"a": [3]}}, "study.rows.a must be a list of overrides"),
        ({"rows": {"a": ["warm_start=nope"]}}, "study.rows.a: warm_start must be a run folder"),
        ({"rows": {"a": ["+auxiliary_losses.x=3"]}}, "study.rows.a: auxiliary_losses.x must be a"),
        ({"rows": {"a": ["augmentation=3"]}}, "study.rows.a: augmentation must be a table"),
        ({"rows": {"a": ["+loss._target_=no.X"]}}, "study.rows.a: loss._target_ must name some"),
        ({"rows": {"a": ["scheduler.min_lr=x"]}}, "study.rows.a: scheduler.min_lr must be a"),
        ({"rows": {"a": ["env.base_env=3"]}}, "study.rows.a: a value may be of another kind"),
        ({"tests": {"n": "env=icub_balance"}}, "study.tests.n must be a list, got env=icub"),
        ({"tests": {"n": ["+minibatch=7"]}}, "study.tests.n: minibatch is not a key"),
        ({"tests": [1]}, r"study.tests must be a table, NAME: VALUE, got \[1\]"),
        ({"battery": "planar"}, "study.battery must be {name: ..., ...}, got planar"),
        ({"training_size": "abc"}, "study.training_size: could not convert"),
        ({"beside": {"none": {"kneel": 5}}}, "study.beside.none: it must be a name or a list"),
        ({"seeds": []}, r"study.seeds must be whole numbers from 0 on, got \[\]"),
        ({"row_seeds": {"none": ["x"]}}, "study.row_seeds.none must be whole numbers"),
        ({"total_frames": 0}, "study.total_frames must be a positive number, got 0"),
        ({"tests": {"n": ["env.transforms.nois=null"]}}, "study.tests.n: Could not override"),
        ({"beside": {"none": {"recover": "nope"}}}, "study.beside.none: run must be a run folder"),
        (
            {"beside": {"none": {"recover": "best"}}},
            "study.tests must switch what stands beside none: .* got its own",
        ),
        (
            {
                "beside": {"none": {"recover": "best"}},
                "tests": {"modes": ["experiment=push_to_kneel"]},
            },
            "none and recover must have the same env.transforms.observation",
        ),
    ],
)
def test_studies_that_would_fail_after_training_are_refused_before(change, message):
    study = OmegaConf.create(yaml.safe_load(STUDY) | change)
    with (
        initialize_config_module("recipes", version_base=None),
        pytest.raises(ValueError, match=message),
    ):
        plan(study)


def test_results_of_other_movements_are_others(monkeypatch, tmp_path):
    """A study whose script kneels depends on a file that no config names."""
    study = OmegaConf.create(yaml.safe_load(KNEELING))
    other = tmp_path / "catches.npz"
    other.write_bytes(b"other movements")
    with initialize_config_module("recipes", version_base=None):
        before = [run.tests[0].name for run in plan(study)]
        monkeypatch.setattr(study_plan, "MOVEMENTS", other)
        after = [run.tests[0].name for run in plan(study)]
    same = [one == other for one, other in zip(before, after, strict=True)]
    assert same == [True, True, False]  # rows of two, one, and script


@pytest.mark.parametrize(
    ("role", "expected"), [("recover", [2.0, 1.0, 1.0]), ("kneel", [1.0, 2.0, 2.0])]
)
def test_each_of_two_policies_acts_in_its_own_mode(role, expected, monkeypatch):
    """This one says 1 and the one beside it 2, in RECOVER, KNEEL and STABLE."""

    class Says(TensorDictModuleBase):
        in_keys: ClassVar = ["observation"]
        out_keys: ClassVar = ["action"]

        def __init__(self, value: float):
            super().__init__()
            self.value = value

        def forward(self, td):
            return td.set("action", torch.full((*td.shape, 1), self.value))

    cfg = OmegaConf.create({"env": {"num": 0}, "warm_start": None})
    monkeypatch.setattr(study_runs, "run_folder", lambda runs, cfg: Path("this"))
    monkeypatch.setattr(
        study_runs, "load_run", lambda latest, name: (cfg.env, Says(1.0 if name == "this" else 2.0))
    )
    run = Run("row", 0, cfg, (role, "other"), ())
    _, actor = study_runs.tested(run, study_plan.Test("", None, ""), Path())
    td = TensorDict({"observation": torch.zeros(3, 4), "mode": torch.eye(3)}, [3])
    assert actor(td)["action"][:, 0].tolist() == expected


def test_a_training_depends_on_the_weights_of_its_teacher(compose_config, tmp_path):
    (tmp_path / "checkpoints").mkdir()
    cfg = compose_config(
        "experiment=best", "imitation=teacher", f"auxiliary_losses.imitation.teacher={tmp_path}"
    )
    found = []
    for content in (b"one", b"other", b"one"):
        (tmp_path / "checkpoints" / "last.pt").write_bytes(content)
        found.append(study_plan.training_digest(cfg))
    assert found[0] == found[2] != found[1]


@pytest.mark.parametrize(("version", "kept"), [(VERSION, True), (VERSION - 1, False)])
def test_what_another_version_began_begins_anew(
    monkeypatch, compose_config, tmp_path, version, kept
):
    """Else it would be refused for good, and the row never finished."""
    folder = tmp_path / "run"
    (folder / "checkpoints").mkdir(parents=True)
    checkpoint.save(folder / "checkpoints" / "last.pt", {"run": {"version": version}})
    (folder / "metrics.csv").write_text("update,falls\n1,3\n")
    found = []
    monkeypatch.setattr(
        study_runs,
        "run_training",
        lambda cfg, folder, console: found.append(list(folder.iterdir())) or True,
    )
    study_runs.train(compose_config(), folder)
    assert bool(found[0]) == kept


@pytest.mark.parametrize("key", ["beside", "row_seeds"])
def test_what_is_said_of_a_row_that_is_not_there_is_refused(key):
    study = OmegaConf.create(yaml.safe_load(STUDY) | {key: {"nobody": [0]}})
    with pytest.raises(ValueError, match=f"study.{key} must name rows .none, .*, got nobody"):
        plan(study)


@pytest.mark.parametrize(
    "name", sorted(p.stem for p in (Path(__file__).parents[1] / "recipes" / "study").glob("*.yaml"))
)
def test_every_row_of_the_studies_that_ship_can_be_built(name):
    with initialize_config_module("recipes", version_base=None):
        study = compose("ablate", overrides=[f"study={name}"]).study
        for planned in {one.row: one for one in plan(study)}.values():
            env = instantiate(planned.cfg.env, base_env={"num_envs": 2})
            assert env.reset()["observation"].shape[0] == 2
            for world in planned.tests:
                env, _, _ = battery_env(battery_of(study), in_test(world, planned.cfg.env), 2)
                assert env.reset()["observation"].shape[0] == 2
