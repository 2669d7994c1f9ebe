"""Policies for a robot, from the shell."""

import json
import re

import pandas as pd
import pytest
import torch

from tests.shell import TINY, run
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
    assert about["observation"][-1]["to"] == 3 + 3 + 20 + 20 + 20
    reference = torch.tensor([about["reference_rad"]])
    torch.testing.assert_close(torch.tensor(about["states"]["target"]), reference)


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


def test_a_baseline_cannot_be_exported(tmp_path):
    done = run("export", "run=pose_hold", f"hydra.run.dir={tmp_path}")
    assert "run must hold a policy, pose_hold is a baseline" in done.stderr


@pytest.mark.long
def test_a_policy_with_a_memory_from_the_shell(tmp_path, monkeypatch):
    """Every trial of two directions, three sizes: a policy that has learned nothing holds still."""
    pytest.importorskip("onnxruntime")
    trained = run("train", *TINY, "actor=gru_mog", "critic=gru", f"hydra.run.dir={tmp_path}/run")
    assert trained.returncode == 0, trained.stderr
    small = load_battery("planar", starts=1, directions=2, impulses=[0.2, 1.5], end_time=4.0)
    monkeypatch.setattr("zfall.evaluation.definitions.load_battery", lambda name, **options: small)
    done = run("export", f"run={tmp_path}/run", "planar=1", f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    written = ("policy.onnx", "policy.json")
    assert all((tmp_path / "run" / "export" / name).exists() for name in written)
    assert f"drive policy={tmp_path}/run/export\n" in done.stdout
    assert not (tmp_path / "out").exists()
    assert "4 of 4 pushed trials end the same way" in done.stdout
    table = pd.read_csv(tmp_path / "run" / "export" / "planar.csv")
    assert table["recovered"].tolist() == table["recovered_in_zfall"].tolist()
    assert table["recovered"].tolist() == [True, True, True, True, False, False]


@pytest.mark.parametrize("value", ["0", "1.5", "true", "abc"])
def test_starts_that_are_none_are_refused(tmp_path, value):
    done = run("export", "run=best", f"planar={value}", f"hydra.run.dir={tmp_path}")
    assert re.match(rf"error: planar must be .*, got {value}\.\n", done.stderr)
