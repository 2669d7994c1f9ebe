"""Stages that make a file in place of training: in their order, once, whole, and resumed anywhere."""

import json
import re
import shutil

import pandas as pd
import pytest
import torch
from omegaconf import OmegaConf

from tests.shell import TINY, run
from tests.training.makers import Text
from zfall import checkpoint
from zfall.policies import load_policy
from zfall.training.run_folder import RunFolder
from zfall.training.stages import check_lengths, stages_of, written_out

TEXT, COPY = "tests.training.makers.Text", "tests.training.makers.Copy"
TRUST = "trust=[tests.training.makers]"
FIRST = f"note: {{make: {{_target_: {TEXT}, text: a}}}}"
SECOND = f"longer: {{make: {{_target_: {TEXT}, text: b, after: 'stage:note'}}}}"
LAST = f"copied: {{make: {{_target_: {COPY}, policy: 'stage:second'}}}}"
WHOLE = [
    *(given for given in TINY if not given.startswith("total_frames")),
    f"+stages={{{FIRST}, first: {{total_frames: 64}}, {SECOND},"
    f" second: {{total_frames: 64, actor: {{std: 0.1}}}}, {LAST}}}",
]


class Killed(BaseException):
    """What no program catches."""


@pytest.fixture(autouse=True)
def _nothing_made():
    Text.made.clear()
    Text.dies.clear()


def texts(folder):
    return {path.name: path.read_text() for path in (folder / "made").glob("*.txt")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run that nobody disturbed."""
    Text.made.clear()
    folder = tmp_path_factory.mktemp("whole") / "run"
    done = run("train", *WHOLE, f"hydra.run.dir={folder}")
    assert done.returncode == 0, done.stderr
    assert Text.made == ["note.txt", "longer.txt"]
    return folder, done


def test_files_are_made_between_trainings(whole):
    folder, _ = whole
    assert texts(folder) == {"note.txt": "a", "longer.txt": "ab"}
    metrics = pd.read_csv(folder / "metrics.csv")  # numbers count what is made
    assert list(metrics["stage"]) == [2, 2, 4, 4]
    assert list(metrics["update"]) == [1, 2, 3, 4]
    # A stage that trains goes on from the last one that trained.
    first, second = (
        checkpoint.load(folder / "checkpoints" / f"{n}.pt") for n in ("first", "second")
    )
    assert OmegaConf.create(second["config"]).actor.std == 0.1
    assert first["policy"].keys() == second["policy"].keys()


def test_what_a_maker_reports_is_kept(whole):
    folder, _ = whole
    assert (folder / "made" / "note" / "report.md").read_text() == "a"
    assert not (folder / "made" / "copied").exists()
    assert not (folder / "made" / "note" / "note.txt").exists()


def test_a_training_that_ends_with_a_policy_says_where_it_is(whole):
    folder, done = whole
    assert "checkpoints/copied.pt" in done.stdout
    made, trained = (load_policy(folder, checkpoint=name) for name in ("copied", "second"))
    assert all(map(torch.equal, made.actor.parameters(), trained.actor.parameters()))


@pytest.mark.long
def test_killed_in_made_and_in_trained_stages_and_resumed_it_gives_the_same(
    whole, tmp_path, monkeypatch
):
    """And makes each file once. It begins with resume=auto, from before its first checkpoint."""
    folder, _ = whole
    parts, write, kills = tmp_path / "parts", RunFolder.write, [1, 3]

    def dying(self, learner, *args):
        if kills and kills[0] == self.updates(learner):
            kills.pop(0)
            raise Killed
        return write(self, learner, *args)

    monkeypatch.setattr(RunFolder, "write", dying)
    given = [*WHOLE, f"hydra.run.dir={parts}", "resume=auto"]
    again = [f"resume={parts}", f"hydra.run.dir={tmp_path}/x", TRUST]
    for args, dies in ((given, [Killed()]), (given, []), (again, [Killed()]), (again, [])):
        Text.dies[:] = dies
        with pytest.raises(Killed):
            run("train", *args)
    assert not kills
    done = run("train", *again)
    assert done.returncode == 0, done.stderr
    assert Text.made == ["note.txt", "longer.txt"]
    assert texts(parts) == texts(folder)
    assert (parts / "metrics.csv").read_text() == (folder / "metrics.csv").read_text()
    for name in ("first", "second", "copied", "last"):
        one, other = (
            checkpoint.load(each / "checkpoints" / f"{name}.pt")["policy"]
            for each in (folder, parts)
        )
        assert all(torch.equal(one[key], other[key]) for key in one)


def test_what_is_made_of_a_stage_that_is_made_longer_is_made_anew(whole, tmp_path):
    folder = shutil.copytree(whole[0], tmp_path / "run")
    again = [f"resume={folder}", f"hydra.run.dir={tmp_path}/x", TRUST]
    done = run("train", *again, "+stages.second.total_frames=96")
    assert done.returncode == 0, done.stderr
    assert Text.made == []  # what was made before it stays
    copied, second, before = (
        checkpoint.load(each / "checkpoints" / f"{name}.pt")["policy"]
        for each, name in ((folder, "copied"), (folder, "second"), (whole[0], "copied"))
    )
    assert all(torch.equal(copied[key], second[key]) for key in copied)
    assert not all(torch.equal(copied[key], before[key]) for key in copied)


def test_ctrl_c_while_a_file_is_made_says_how_to_go_on(tmp_path):
    Text.dies[:] = [KeyboardInterrupt()]
    folder = tmp_path / "run"
    done = run("train", *TINY, f"+stages={{{FIRST}, a: {{}}}}", f"hydra.run.dir={folder}")
    assert done.returncode == 130
    assert "stopped; go on with: " in done.stdout
    assert f"resume={folder}" in done.stdout
    assert texts(folder) == {}
    done = run("train", *TINY, f"hydra.run.dir={folder}")
    assert done.returncode == 1
    assert f"resume={folder} goes on with it" in done.stderr
    done = run("train", f"resume={folder}", f"hydra.run.dir={tmp_path}/x", TRUST)
    assert done.returncode == 0, done.stderr
    assert texts(folder) == {"note.txt": "a"}


def test_resume_auto_goes_on_with_no_other_config(tmp_path):
    Text.dies[:] = [KeyboardInterrupt()]
    given = [*TINY, f"hydra.run.dir={tmp_path}/run", "resume=auto"]
    assert run("train", *given, f"+stages={{{FIRST}, a: {{}}}}").returncode == 130
    done = run("train", *given, f"+stages={{{FIRST}, a: {{seed: 5}}}}")
    assert done.returncode == 1
    assert "stages.a.seed (0 stored, 5 wanted) must be that of the run" in done.stderr


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (f"note: {{make: {{_target_: {TEXT}, text: a}}, seed: 1}}",
         "stages.note must hold nothing else where it holds make, got seed"),
        ("note: {make: 5}", "stages.note.make must be a table with the _target_ of a maker, got 5"),
        ("note: {make: null}", "stages.note.make must be a table with the _target_ of a maker"),
        ("note: {make: {text: a}}", "stages.note.make must be a table with the _target_ of a maker"),
        ("note: {make: {_target_: torch.nn.Linear}}",
         "stages.note.make._target_ must name a class with suffix, is_policy, make and stand_in"),
        ("note: {make: {_target_: tests.training.makers.Absent}}", "stages.note.make._target_ must name"),
        (f"note: {{make: {{_target_: {TEXT}, text: a, after: 'stage:a'}}}}, a: {{}}",
         "stages.note.make.after must name no stage, it is the first, got stage:a"),
        (f"{FIRST}, b: {{make: {{_target_: {TEXT}, text: a, after: 'stage:nte'}}}}",
         "stages.b.make.after must name a stage before it, note, got stage:nte"),
        (f"{FIRST}, a: {{warm_start: 'stage:note'}}",
         "stages.a.warm_start must name a stage that comes to a policy, got stage:note"),
    ],
)  # fmt: skip
def test_stages_that_cannot_make_anything_are_refused(given, says):
    cfg = OmegaConf.create(f"{{warm_start: null, actor: {{}}, stages: {{{given}}}}}")
    with pytest.raises(ValueError, match=re.escape(says)):
        stages_of(cfg)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (f"note: {{make: {{_target_: {TEXT}, text: ''}}}}, a: {{}}",
         "error: stages.note.make: text must not be empty, got ''"),
        (f"{FIRST}, a: {{}}, c: {{make: {{_target_: {COPY}, policy: 'stage:note'}}}}",
         "error: stages.c: stage note must be a checkpoint"),
    ],
)  # fmt: skip
def test_makers_are_tried_before_the_first_stage(given, says, tmp_path):
    folder = tmp_path / "run"
    done = run("train", *TINY, f"+stages={{{given}}}", f"hydra.run.dir={folder}")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert says in done.stderr
    assert not folder.exists()


def test_a_maker_that_writes_nothing_is_refused(tmp_path):
    given = "+stages={a: {make: {_target_: tests.training.makers.Nothing, text: a}}}"
    done = run("train", *TINY, given, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 1
    assert "stages.a.make must write a.txt" in done.stderr


def test_a_training_may_make_files_alone(tmp_path):
    given = [f"+stages={{{FIRST}, {SECOND}}}", "num_envs=8"]
    done = run("train", *given, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr
    assert texts(tmp_path / "run") == {"note.txt": "a", "longer.txt": "ab"}


def test_written_out_they_are_the_same_stages():
    table = {"seed": 1, "warm_start": None, "actor": {"std": 0.1}, "total_frames": 5}
    text = {"_target_": TEXT, "text": "${seed}", "after": "stage:a"}
    table["stages"] = {
        "a": {},
        "b": {"make": text},
        "c": {"make": {"_target_": COPY, "policy": "x"}},
    }
    whole = written_out(OmegaConf.create(table))
    assert "${" not in whole
    made = stages_of(OmegaConf.create(whole))
    assert [stage.make for stage in made] == [
        None,
        {"_target_": TEXT, "text": 1, "after": "stage:a"},
        {"_target_": COPY, "policy": "x"},
    ]
    assert [stage.file for stage in made] == ["checkpoints/a.pt", "made/b.txt", "checkpoints/c.pt"]


def test_a_stage_that_makes_something_has_no_length():
    cfg = f"stages: {{a: {{make: {{_target_: {TEXT}}}}}, b: {{total_frames: 10}}}}"
    with pytest.raises(ValueError, match=r"stages.a.total_frames must be .*: \+stages.b.total"):
        check_lengths(cfg, ["+stages.a.total_frames=30"])
    with pytest.raises(ValueError, match="total_frames must be given for a stage"):
        check_lengths(cfg, ["total_frames=30"])
    check_lengths(cfg, ["+stages.b.total_frames=30"])


def test_nothing_of_a_strangers_makers_is_executed(tmp_path):
    """What a run was begun with is read as a checkpoint is: without what zfall does not trust."""
    Text.dies[:] = [KeyboardInterrupt()]
    folder = tmp_path / "run"
    given = [*TINY, f"+stages={{{FIRST}, a: {{}}}}", f"hydra.run.dir={folder}"]
    assert run("train", *given).returncode == 130
    done = run("train", f"resume={folder}", f"hydra.run.dir={tmp_path}/x")
    assert done.returncode == 1
    assert "stages.note.make._target_ must name what zfall or a trusted module" in done.stderr
    path = folder / "checkpoints" / "begun.json"
    path.write_text(json.dumps({"version": 7}))
    done = run("train", f"resume={folder}", f"hydra.run.dir={tmp_path}/x", TRUST)
    assert done.returncode == 1
    assert "begun.json must be as it was written" in done.stderr
