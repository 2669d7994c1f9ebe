"""Which policies and baselines are tested, and in which world."""

import json
import os

import pandas as pd
import pytest
from omegaconf import OmegaConf

import zfall
from tests.shell import SMALL, TINY, run
from zfall import checkpoint, migrations
from zfall.evaluation.candidate import (
    Candidate,
    load_candidate,
    load_candidates,
    read_trials,
    write_trials,
)
from zfall.evaluation.definitions import load_battery


def test_checkpoint_of_another_robot_is_refused(trained, tmp_path):
    content = checkpoint.load(trained / "checkpoints" / "last.pt")
    content.pop("format")
    (tmp_path / "checkpoints").mkdir()
    checkpoint.save(tmp_path / "checkpoints" / "last.pt", content | {"robot": "other"})
    done = run("evaluate", f"run={tmp_path}")
    assert done.returncode != 0
    assert "must be of the robot zeroth01 " in done.stderr
    assert "it is of other" in done.stderr


def test_run_without_a_checkpoint_is_refused(tmp_path):
    done = run("evaluate", f"run={tmp_path}")
    assert done.returncode != 0
    assert f"run must be a run folder, {tmp_path} has no checkpoints." in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_newest_run_in_a_folder_of_runs_is_named(tmp_path):
    for name, time in (("a/older", 2), ("b/newest", 3), ("c", 1)):
        (tmp_path / name / "checkpoints").mkdir(parents=True)
        os.utime(tmp_path / name / "checkpoints", (time, time))
    for recipe, key in (("evaluate", "run"), ("train", "resume")):
        done = run(recipe, f"{key}={tmp_path}", f"hydra.run.dir={tmp_path}/out")
        assert f"{key} must be a run folder, {tmp_path} has no checkpoints;" in done.stderr
        assert done.stderr.endswith(f"the newest run in it is {tmp_path}/b/newest.\n")


def test_a_refused_evaluation_leaves_nothing(trained, tmp_path):
    before = sorted(trained.rglob("*"))
    done = run("evaluate", f"runs=[{trained},nowhere]", f"hydra.run.dir={tmp_path}/out")
    assert "there is no folder nowhere" in done.stderr
    done = run("evaluate", f"run={trained}", *SMALL, "trial=0", "joint=nose")
    assert "joint must be one of" in done.stderr
    assert sorted(trained.rglob("*")) == before
    assert not (tmp_path / "out").exists()


def test_values_of_the_env_can_be_changed_and_must_be_there(trained):
    done = run("evaluate", f"run={trained}", *SMALL, 'change=["transforms.action.scale=0.3"]')
    assert done.returncode == 0, done.stderr
    bad = run("evaluate", f"run={trained}", *SMALL, 'change=["transforms.action.skale=0.3"]')
    assert "change must name a value of the env, there is no transforms.action.skale" in bad.stderr


@pytest.mark.long
def test_baselines_next_to_a_policy_meet_its_world(tmp_path):
    tiny = [*TINY, "env.base_env.physics_dt=0.008"]
    assert run("train", *tiny, f"hydra.run.dir={tmp_path}/one").returncode == 0
    runs = [f"runs=[{tmp_path}/one,pose_hold]", f"hydra.run.dir={tmp_path}/both"]
    done = run("evaluate", *runs, "battery=planar", *SMALL, "num_envs=64")
    assert done.returncode == 0, done.stderr
    (asked,) = (tmp_path / "both" / "pose_hold").glob("evaluation/*/trials.json")
    assert (
        OmegaConf.create(json.loads(asked.read_text())["config"]["env"]).base_env.physics_dt
        == 0.008
    )


@pytest.mark.parametrize("name", ["start", "push"])
def test_starts_and_pushes_of_training_cannot_be_kept_in_a_battery(name):
    done = run("evaluate", "run=best", f"keep=[{name}]")
    assert done.returncode != 0
    assert f"keep must not name {name}: a battery has its own starts and pushes" in done.stderr


def test_a_baseline_meets_the_first_policy_in_whose_world_it_can_act():
    """``best`` has no modes, ``kneel`` has; the order in which they are named is kept."""
    names = ["scripted_kneel", "best", "pose_hold", "kneel"]
    scripted, best, still, kneel = load_candidates(names, change=["base_env.physics_dt=0.008"])
    assert [scripted.name, best.name, still.name, kneel.name] == names
    assert still.env_cfg == best.env_cfg
    assert scripted.env_cfg.transforms.keys() == kneel.env_cfg.transforms.keys()
    assert all(each.env_cfg.base_env.physics_dt == 0.008 for each in (scripted, best, still, kneel))
    with pytest.raises(ValueError, match="env .*best"):
        load_candidates(["best", "pose_hold"], task="zeroth_fall")


def test_a_checkpoint_is_that_of_the_runs_and_baselines_have_none(trained):
    run, still = load_candidates([str(trained), "pose_hold"], checkpoint="best")
    assert (run.name, still.name) == (str(trained), "pose_hold")
    for others in (["pose_hold"], [zfall.load_policy("best"), "pose_hold"]):
        with pytest.raises(ValueError, match="checkpoint must be last or best of pose_hold, got"):
            load_candidates(others, checkpoint="foo")


def test_a_policy_is_taken_as_it_is_or_by_its_name():
    given, named = load_candidate(zfall.load_policy("best")), load_candidate("best")
    battery = load_battery("planar", starts=1)
    conditions = [each.conditions(battery, seed=0) for each in (given, named)]
    assert conditions[0] == conditions[1]
    with pytest.raises(ValueError, match="run .*pose_hold, limp, .*best.*nowhere"):
        load_candidate("nowhere")


def test_trials_are_read_under_the_same_conditions_alone(tmp_path, compose_config):
    """Another seed, another number of the battery, another world."""
    battery, cfg = load_battery("planar", starts=1), compose_config("num_envs=2").env
    plain = Candidate("pose_hold", cfg, None)
    noisy = plain.keep(["noise"])
    trials = pd.DataFrame({"trial": [0, 1], "recovered": [True, False]})
    path = tmp_path / "trials.csv"

    def conditions(candidate=plain, battery=battery, seed=0):
        return candidate.conditions(battery, seed=seed)

    write_trials(path, trials, conditions())
    assert read_trials(path, conditions()).equals(trials)
    others = [{"seed": 1}, {"battery": load_battery("planar", starts=2)}, {"candidate": noisy}]
    assert all(read_trials(path, conditions(**other)) is None for other in others)
    path.write_text('trial,recovered\n0,"')
    with pytest.raises(ValueError, match=r"trials\.csv must be a table in csv, it is damaged"):
        read_trials(path, conditions())
    path.with_suffix(".json").write_text('{"config": 3}')
    with pytest.raises(ValueError, match=r"trials\.json must be as it was written"):
        read_trials(path, conditions())


def test_trials_are_read_by_a_version_with_more_keys(tmp_path, compose_config, monkeypatch):
    """A key of the env and one of the battery, each with a line in the table."""
    battery = load_battery("planar", starts=1)
    stored = Candidate("pose_hold", compose_config("num_envs=2").env, None)
    conditions = stored.conditions(battery, seed=0)
    older = json.loads(json.dumps(conditions))
    del older["config"]["env"]["base_env"]["physics_dt"]
    del older["config"]["battery"]["planar"]["max_tilt"]
    write_trials(tmp_path / "trials.csv", pd.DataFrame({"trial": [0]}), older)
    assert read_trials(tmp_path / "trials.csv", conditions) is None
    monkeypatch.setitem(migrations.MISSING, "env.base_env.physics_dt", 0.004)
    monkeypatch.setitem(migrations.MISSING, "battery.*.max_tilt", battery.max_tilt)
    assert read_trials(tmp_path / "trials.csv", conditions) is not None
