"""What is said of how far a policy gets."""

import json
import math

import pytest
import torch
from hydra.utils import instantiate
from rich.console import Console

from recipes.play import walk
from tests.shell import TINY, run
from zfall.envs.make import make_env
from zfall.envs.tables import keep
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.starts import ScriptedStart


def test_speed_and_distance_are_those_of_a_flight(make_base):
    """In free fall from 9 m the level velocity stays: a quarter of the worlds face against it."""
    base = make_base(num_envs=64)
    heading = torch.full((64,), math.radians(60.0))
    flip = torch.arange(64) % 4 == 0
    faces = heading + math.pi * flip
    zero = torch.zeros(64)
    start = ScriptedStart(
        base,
        states={
            "base_position": torch.tensor([[1.0, 2.0, 9.0]]).repeat(64, 1),
            "base_orientation": torch.stack([(faces / 2).cos(), zero, zero, (faces / 2).sin()], -1),
            "base_linear_velocity": 0.5 * torch.stack([heading.cos(), heading.sin(), zero], -1),
        },
    )
    env = make_env(base, {"action": JointPositionTarget(base, scale=0.6), "start": start})
    results, states, forces = walk(env, None, 1.0, Console(quiet=True))
    assert results["fell"] == 0
    assert results["seconds"] == pytest.approx(1.0)
    assert results["forward_velocity"] == pytest.approx(0.5 * (48 - 16) / 64, rel=0.02)
    assert results["distance"] == pytest.approx(0.5 * (1.0 - base.control_dt), rel=0.02)
    assert states.shape[1] == forces.shape[1] == 4


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


def test_baselines_play_in_the_env_that_is_asked_for(tmp_path):
    """Servos that hold stand for two seconds, without servos the robot falls."""
    where = [f"hydra.run.dir={tmp_path}", "seconds=2.0", "video=false", "num_envs=2"]
    for name, env, fell in (("pose_hold", "zeroth_fall", 0), ("limp", "push_recovery", 64)):
        done = run("play", f"run={name}", f"env={env}", *where)
        assert "num_envs: 64, for worlds are played by 64" in done.stdout
        assert json.loads((tmp_path / "play.json").read_text())["fell"] == fell, done.stderr
    done = run("play", "run=best", "env=zeroth_fall", *where)
    assert "env must be given for baselines alone, best has its own." in done.stderr


@pytest.mark.parametrize("kept", [[], ["push"]])
def test_pushes_are_there_if_they_are_kept(compose_config, kept):
    often = ["env.transforms.push.interval=[0.0,0.1]", "num_envs=64"]
    env = instantiate(keep(compose_config(*often).env, kept), training=False)
    _, _, forces = walk(env, None, 1.0, Console(quiet=True))
    assert (forces != 0).any() == bool(kept)


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
