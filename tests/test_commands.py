"""What recipes leave behind in the working directory."""

import pytest

from tests.shell import TINY, run
from zfall.commands import remove_if_empty


def test_empty_folders_below_the_working_directory_go(tmp_path, monkeypatch):
    here = tmp_path / "here"
    for folder in ("runs/one/a", "runs/two/b"):
        (here / folder).mkdir(parents=True)
    (here / "runs" / "two" / "notes.txt").write_text("mine")
    monkeypatch.chdir(here)
    remove_if_empty(here / "runs" / "one" / "a")
    assert sorted(path.name for path in (here / "runs").iterdir()) == ["two"]
    remove_if_empty(here / "runs" / "two")  # it holds something
    remove_if_empty(here / "runs" / "two" / "b")
    assert [path.name for path in (here / "runs" / "two").iterdir()] == ["notes.txt"]
    outside = tmp_path / "outside" / "run"
    outside.mkdir(parents=True)
    remove_if_empty(outside)
    assert outside.parent.exists()  # it may be somebody's
    assert here.exists()


@pytest.mark.parametrize(
    ("recipe", "arguments"),
    [("train", [*TINY, "rollout_steps=0"]), ("train", [*TINY, "minibatches=99"]), ("play", ["run=nowhere"])],
)  # fmt: skip
def test_a_refusal_leaves_nothing_in_the_working_directory(
    recipe, arguments, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert run(recipe, *arguments).returncode == 1
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("recipe", "change", "key"),
    [
        ("ablate", "runs={_target_: os.getcwd}", "runs"),
        ("ablate", "trust=[{_target_: os.getcwd}]", "trust.0"),
        ("evaluate", "battery.impulses=[nan,1]", "battery.impulses.0"),
        ("ablate", "study.training_size={a: 1}", "study.training_size"),
        ("evaluate", "battery.min_height=inf", "battery.min_height"),
        ("evaluate", "+battery.sixe=1", "battery.sixe is not a key"),
        ("train", "env.transforms.limit._target_=builtins.dict", "env.transforms.limit._target_"),
        ("train", "hydra.run.dir={_target_: os.getcwd}", "hydra.run.dir"),
        ("train", "hydra.callbacks.a._target_=nowhere.Nobody", "hydra.callbacks.a"),
        ("train", "hydra.job.env_set=[1]", "hydra.job.env_set"),
        ("train", "hydra.output_subdir={a: 1}", "hydra.output_subdir"),
        ("train", "hydra/launcher=nobody", "hydra/launcher"),
        ("train", "hydra/job_logging=nobody", "hydra/job_logging"),
        ("train", "hydra.verbose=[3]", "hydra"),
        ("train", "hydra.searchpath=[3]", "hydra.searchpath"),
        ("train", "hydra.mode=ALL", "hydra.mode"),
    ],
)
def test_one_line_says_what_hydra_or_a_recipe_refuses(recipe, change, key, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = {"ablate": ["study=actor"], "evaluate": ["run=pose_hold", "battery=spherical"]}
    done = run(recipe, *given.get(recipe, TINY), change)
    assert done.returncode == 1, done
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("error: ")
    assert key in done.stderr
    assert not any(tmp_path.iterdir())
