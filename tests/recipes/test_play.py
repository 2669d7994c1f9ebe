"""What is said of how far a policy gets."""

import json

import pytest

from tests.shell import TINY, run


def test_playing_a_run_writes_its_figures(tmp_path):
    assert run("train", *TINY, f"hydra.run.dir={tmp_path}").returncode == 0
    done = run("play", f"run={tmp_path}", "seconds=0.01", "video=false")
    assert "error: seconds must be at least control_dt 0.04, got 0.01." in done.stderr
    done = run("play", f"run={tmp_path}", "seconds=0.2", "video=false")
    assert done.returncode == 0, done.stderr
    assert "forward_velocity" in (tmp_path / "play.json").read_text()
    assert "left out: delay, push, noise" in done.stdout
    done = run("play", f"run={tmp_path}", "seconds=0.2", "video=false", "keep=[start,push]")
    assert "left out: delay, noise" in done.stdout


def test_baselines_play_in_the_env_that_is_given(tmp_path):
    """Servos that act stand for three seconds, without servos the robot falls."""
    where = [f"hydra.run.dir={tmp_path}", "seconds=3.0", "video=false", "num_envs=2"]
    for name, env, fell in (("pose_hold", "zeroth_fall", 0), ("limp", "push_recovery", 64)):
        done = run("play", f"run={name}", f"env={env}", *where)
        assert "num_envs: 64, the next multiple of 64" in done.stdout
        assert json.loads((tmp_path / "play.json").read_text())["fell"] == fell, done.stderr
    done = run("play", "run=best", "env=zeroth_fall", *where)
    assert "env must be given for baselines alone, best has its own." in done.stderr


def test_pushes_of_a_film_can_be_planned(tmp_path):
    """4.9 N s from the side fell the held pose, 0.5 N s do not (I = 1.0 and 0.1)."""
    where = [f"hydra.run.dir={tmp_path}", "seconds=2.0", "video=false", "num_envs=64"]
    who = ["run=pose_hold", "env=push_recovery", "keep=[push]"]
    target = "zfall.envs.transforms.pushes.ScriptedPush"
    for newtons, fell in ((49, 64), (5, 0)):
        planned = f"{{_target_: {target}, point: torso, duration: 0.1, time: 0.5, plan: [0, {newtons}, 0]}}"
        done = run("play", *who, *where, f"change=['transforms.push={planned}']")
        assert done.returncode == 0, done.stderr
        assert json.loads((tmp_path / "play.json").read_text())["fell"] == fell


def test_pushes_come_on_request_and_falls_are_counted(tmp_path):
    """I = 1 fells the held pose in all directions, I = 0.05 in none."""
    where = [f"hydra.run.dir={tmp_path}", "seconds=2.5", "video=false", "env=push_recovery"]
    for size, fell in (("1.0", 64), ("[0.05]", 0)):
        done = run("play", "run=pose_hold", *where, f"pushes={size}")
        assert f"fell: {fell} of 64 worlds" in done.stdout, done.stderr
    done = run("play", "run=pose_hold", *where, "pushes=0.4", "keep=[push]")
    assert "error: pushes must be null" in done.stderr


def test_a_policy_that_ships_leaves_its_figures_in_hydras_folder(tmp_path):
    done = run("play", "run=atalante", "seconds=0.2", "video=false", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert "forward_velocity" in (tmp_path / "play.json").read_text()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["video=false"], "error: run must be a run folder, a policy that ships or pose_hold"),
        (["run=nowhere"], "there is no folder nowhere"),
        (["run=nowhere", "+second=3"], "second is not a key of the config"),
    ],
)
def test_bad_input_is_refused_in_one_line(given, message):
    done = run("play", *given)
    assert done.returncode == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
