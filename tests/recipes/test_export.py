"""Policies for a robot, from the shell."""

import json
import re
import subprocess
import sys

import pandas as pd
import pytest

from tests.shell import ROOT, TINY, run
from zfall.evaluation.definitions import load_battery


def test_a_run_is_exported_with_what_its_numbers_mean(tmp_path):
    pytest.importorskip("onnxruntime")
    tiny = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    assert run("train", *tiny, f"hydra.run.dir={tmp_path}/run").returncode == 0
    done = run("export", f"run={tmp_path}/run", f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    about = json.loads((tmp_path / "run" / "export" / "policy.json").read_text())
    assert about["control_dt_s"] == 0.04
    assert len(about["joints"]) == len(about["reference_rad"]) == 20
    assert about["observation"][0] == {
        "name": "projected_gravity",
        "from": 0,
        "to": 3,
        "unit": "1, base axes",
    }
    assert about["observation"][-1]["to"] == about["observation_size"]


@pytest.mark.parametrize(("name", "newtons"), [("best", 20), ("best_gru", 20), ("zeroth_fall", 10)])
def test_the_script_drives_the_robot_through_its_push(name, newtons, tmp_path):
    """Pushed after 3 s a policy that ships still stands after 10 s, by MuJoCo alone."""
    pytest.importorskip("onnxruntime")
    done = run("export", f"run={name}", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    files = [f"{tmp_path}/policy.onnx", f"{tmp_path}/policy.json"]
    command = [sys.executable, "docs/drive.py", *files, str(newtons)]
    drive = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    height = float(drive.stdout.split(" m above")[0].split()[-1])
    assert height > 0.3  # standing it is 0.33 m


def test_what_is_observed_through_an_estimator_is_not_exported_as_the_true_quantity(tmp_path):
    tiny = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    speed = "{_target_: zfall.envs.transforms.estimation.NumericalVelocity, before: observation}"
    run("train", *tiny, f"+env.transforms.speed={speed}", "env.transforms.noise=null",
        "~env.training_only.noise", f"hydra.run.dir={tmp_path}/run")  # fmt: skip
    done = run("export", f"run={tmp_path}/run", f"hydra.run.dir={tmp_path}/out")
    assert "must observe true quantities to be exported, got NumericalVelocity" in done.stderr


def test_what_a_transform_counts_is_not_exported(tmp_path):
    tiny = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    air = "{_target_: zfall.envs.transforms.windows.FeetAirTime, before: observation}"
    keys = "env.transforms.observation.keys=[joint_position,feet_air_time]"
    trained = run(
        "train", *tiny, f"+env.transforms.air={air}", keys, f"hydra.run.dir={tmp_path}/run"
    )
    assert trained.returncode == 0, trained.stderr
    done = run("export", f"run={tmp_path}/run", f"hydra.run.dir={tmp_path}/out")
    assert "must observe what a robot can know to be exported, got feet_air_time" in done.stderr
    assert not (tmp_path / "run" / "export").exists()


def test_the_script_knows_the_last_action_and_every_sensor(tmp_path):
    """Feet that have several sensors, and what the policy did before."""
    pytest.importorskip("onnxruntime")
    tiny = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    keys = (
        "env.transforms.observation.keys=[joint_position,feet_position,feet_velocity,last_action]"
    )
    assert run("train", *tiny, keys, f"hydra.run.dir={tmp_path}/run").returncode == 0
    done = run("export", f"run={tmp_path}/run", f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    command = [sys.executable, "docs/drive.py"]
    files = [f"{tmp_path}/run/export/policy.{ending}" for ending in ("onnx", "json")]
    drive = subprocess.run([*command, *files, "0"], cwd=ROOT, capture_output=True, text=True)
    assert drive.returncode == 0, drive.stderr
    bare = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert bare.stderr.startswith("usage: docs/drive.py policy.onnx policy.json")


def test_a_baseline_cannot_be_exported(tmp_path):
    done = run("export", "run=pose_hold", f"hydra.run.dir={tmp_path}")
    assert "run must hold a policy, pose_hold is a baseline" in done.stderr


def test_a_policy_with_a_memory_from_the_shell(tmp_path, monkeypatch):
    """Every trial of two directions, three sizes: a policy that has learned nothing holds still."""
    pytest.importorskip("onnxruntime")
    trained = run("train", *TINY, "actor=gru_mog", "critic=gru", f"hydra.run.dir={tmp_path}/run")
    assert trained.returncode == 0, trained.stderr
    small = load_battery("planar", starts=1, directions=2, impulses=[0.2, 1.5], end_time=4.0)
    monkeypatch.setattr("zfall.evaluation.definitions.load_battery", lambda name, **options: small)
    done = run("export", f"run={tmp_path}/run", "planar=1", f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    written = [f"{tmp_path}/run/export/{name}" for name in ("policy.onnx", "policy.json")]
    assert f"docs/drive.py {' '.join(written)}\n" in done.stdout
    assert not (tmp_path / "out").exists()
    assert "4 of 4 pushed trials end the same way" in done.stdout
    table = pd.read_csv(tmp_path / "run" / "export" / "planar.csv")
    assert table["recovered"].tolist() == table["recovered_in_zfall"].tolist()
    assert table["recovered"].tolist() == [True, True, True, True, False, False]


@pytest.mark.parametrize("value", ["0", "1.5", "true", "abc"])
def test_starts_that_are_none_are_refused(tmp_path, value):
    done = run("export", "run=best", f"planar={value}", f"hydra.run.dir={tmp_path}")
    assert re.match(rf"error: planar must be .*, got {value}\.\n", done.stderr)
