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
