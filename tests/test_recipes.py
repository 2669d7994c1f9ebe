"""Recipes from the shell: they run, write their files, and refuse bad input in one line."""

import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).parents[1]
TINY = ["num_envs=8", "rollout_steps=4", "minibatches=2", "total_frames=64", "checkpoint_every=1",
        "showcase.starts=1", "showcase.sizes=[0.4]", "showcase.video=false"]  # fmt: skip


def run(module: str, *args: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", f"recipes.{module}", *args]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    done = run("train", *TINY, f"hydra.run.dir={folder}")
    assert done.returncode == 0, done.stderr
    assert "pose_hold" in done.stdout
    return folder


def test_training_leaves_the_files_of_a_run(trained):
    for name in ("metrics.csv", "timing.csv", "summary.json", ".hydra/config.yaml",
                 "checkpoints/last.pt", "checkpoints/best.pt", "plots/planar.png",
                 "plots/learning_curves.png", "tensorboard"):  # fmt: skip
        assert (trained / name).exists(), name
    metrics = pd.read_csv(trained / "metrics.csv")
    assert metrics["frames"].tolist() == [32, 64]
    expected = {"episode_return", "episode_seconds", "kl", "reward/upright", "loss/objective"}
    assert expected <= set(metrics.columns)
    assert not [column for column in metrics if "_s" in column[-3:] and column != "episode_seconds"]


def test_battery_of_a_run_and_of_a_baseline(trained, tmp_path):
    options = "options={starts: 1, directions: 2, impulses: [0.2], end_time: 3.4}"
    done = run("evaluate", f"run={trained}", "battery=planar", options, "num_envs=64")
    assert done.returncode == 0, done.stderr
    folder = trained / "evaluation" / "planar"
    summary = json.loads((folder / "summary.json").read_text())
    assert {"battery_version", "n", "i50_mean", "i50_min", "i90_mean", "i50", "success", "success_low",
            "success_high", "control_falls", "control_n"} <= set(summary)  # fmt: skip
    trials = pd.read_csv(folder / "trials.csv")
    assert len(trials) == summary["n"] == 4
    assert {"direction_rad", "impulse", "duration_s", "force_n", "body", "seed", "recovered", "fell",
            "kneeled", "time_to_fall_s", "peak_base_acceleration",
            "peak_contact_force"} <= set(trials.columns)  # fmt: skip
    assert (folder / "success_map.png").exists()


@pytest.mark.parametrize("actor", ["mlp_gaussian", "gru_mog"])
def test_stopped_and_resumed_run_equals_the_one_not_stopped(actor, tmp_path):
    """Same metrics, to the last digit; a row written after the checkpoint is dropped."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    common = [*TINY, f"actor={actor}"]
    assert run("train", *common, "total_frames=128", f"hydra.run.dir={whole}").returncode == 0
    assert run("train", *common, "total_frames=64", f"hydra.run.dir={parts}").returncode == 0
    with (parts / "metrics.csv").open("a") as file:
        file.write("3,96,half a row")
    done = run("train", f"resume={parts}", "total_frames=128", f"hydra.run.dir={tmp_path}/x")
    assert done.returncode == 0, done.stderr
    assert (parts / "metrics.csv").read_text() == (whole / "metrics.csv").read_text()


@pytest.mark.parametrize("actor", ["mlp_mog", "gru_mog"])
def test_every_actor_trains(actor, tmp_path):
    done = run("train", *TINY, f"actor={actor}", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr


BAD = [
    (["num_envs=0"], "num_envs must be at least 1, got 0"),
    (["num_envs=-4"], "num_envs must be at least 1, got -4"),
    (["env.base_env.control_dt=0.03"], "control_dt must be a multiple of physics_dt"),
    (["env.transforms.delay.delay=[0,0.5]"], "env.transforms.delay: delay must be"),
    (["env.transforms.push.point=tail"], "env.transforms.push: point must be a push point"),
    (["+env.transforms.push.impulze=1"], "impulze"),
    (["+epoch=3"], "epoch is not a key of the config"),
    (["actor=mlp_transformer"], "mlp_transformer"),
    (["resume=nowhere"], "there is no such file"),
    (["hydra.run.dir=/proc/zfall"], "/proc/zfall"),
]


@pytest.mark.parametrize(("overrides", "message"), BAD, ids=[" ".join(o) for o, _ in BAD])
def test_bad_input_ends_before_the_first_step_with_a_clear_line(overrides, message, tmp_path):
    folder = [] if "hydra.run.dir" in overrides[0] else [f"hydra.run.dir={tmp_path}"]
    done = run("train", *TINY, *folder, *overrides)
    assert done.returncode != 0
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "metrics.csv").exists()


def test_checkpoint_of_another_actor_is_refused(trained, tmp_path):
    done = run("train", *TINY, f"resume={trained}", "actor=mlp_mog", f"hydra.run.dir={tmp_path}")
    assert done.returncode != 0
    assert "actor must not be given with resume" in done.stderr


def test_run_without_a_checkpoint_is_refused(tmp_path):
    done = run("evaluate", f"run={tmp_path}")
    assert done.returncode != 0
    assert "there is no such file" in done.stderr
