"""Robots that do not ship go from an MJCF to a training, a battery and an exported policy."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from tests.block import HALF_HEIGHT, HALF_WIDTH, MASS, bare_block, inertia
from tests.shell import TINY, run
from tests.toy import toy_mjcf
from zfall.configs import compose_config
from zfall.evaluation.candidate import Candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.run import evaluate, trials_of
from zfall.robots import GRAVITY

GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "your-robot.md"
SMALL = ["starts=1", "directions=2", "impulses=[0.1]"]


def yaml_of(name: str, mjcf: Path, more: str = "") -> str:
    lines = ["# @package env.base_env", "servos: null", "robot:", "  _target_: zfall.robots.Robot"]
    return "\n".join([*lines, f"  name: {name}", f"  mjcf: {mjcf}", more])


def of_the_guide() -> str:
    """The yaml that the guide shows."""
    (found,) = re.findall(r"```yaml\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    return str(found)


@pytest.mark.long
@pytest.mark.parametrize(("name", "joints"), [("humanoid", 21), ("toy", 6), ("block", 1)])
def test_a_robot_goes_from_its_mjcf_to_a_policy_for_its_computer(tmp_path, name, joints):
    pytest.importorskip("onnxruntime")
    text = {
        "humanoid": of_the_guide,
        "toy": lambda: yaml_of("toy", toy_mjcf(tmp_path)),
        "block": lambda: yaml_of("block", bare_block(tmp_path)),
    }[name]()
    conf = tmp_path / "conf"
    (conf / "robot").mkdir(parents=True)
    (conf / "robot" / f"{name}.yaml").write_text(text)
    folder, own = tmp_path / "run", ["--config-dir", str(conf)]
    trained = run("train", *own, f"robot={name}", *TINY, f"hydra.run.dir={folder}")
    assert trained.returncode == 0, trained.stderr
    assert pd.read_csv(folder / "metrics.csv")["frames"].tolist() == [32, 64]
    tested = run("evaluate", *own, f"run={folder}", "battery=planar", *SMALL, "num_envs=64")
    assert tested.returncode == 0, tested.stderr
    (trials,) = folder.glob("evaluation/*/trials.csv")
    assert not pd.read_csv(trials)["recovered"].isna().any()
    exported = run("export", f"run={folder}", f"hydra.run.dir={tmp_path}/out")
    assert exported.returncode == 0, exported.stderr
    about = json.loads((folder / "export" / "policy.json").read_text())
    assert about["robot"] == name
    assert len(about["joints"]) == joints


def test_a_bare_block_tips_at_the_impulse_of_rigid_body_mechanics(tmp_path):
    """As the block with its own sensors: soles, floor and push points are added to this one.

    ``J z = I w`` about the edge, at the center of percussion, and ``I w^2 / 2 = m g (r - h)``.
    """
    about_edge = inertia()[0] + MASS * (HALF_WIDTH**2 + HALF_HEIGHT**2)
    height = about_edge / (MASS * HALF_HEIGHT)
    rise = math.hypot(HALF_WIDTH, HALF_HEIGHT) - HALF_HEIGHT
    spin = math.sqrt(2 * MASS * GRAVITY * rise / about_edge)
    impulse = about_edge * spin / height / (MASS * math.sqrt(GRAVITY * HALF_HEIGHT))
    action = "zfall.envs.transforms.actions.JointPositionTarget"
    point = {"_target_": "zfall.robots.PushPoint", "body": "block"}
    robot = {
        "_target_": "zfall.robots.Robot",
        "name": "block",
        "mjcf": str(bare_block(tmp_path)),
        "push_points": {"percussion": point | {"offset": [0.0, 0.0, height - HALF_HEIGHT]}},
    }
    cfg = OmegaConf.create(
        {
            "base_env": {
                "_target_": "zfall.envs.humanoid.HumanoidEnv",
                "control_dt": 0.01,
                "physics_dt": 0.001,
                "robot": robot,
            },
            "transforms": {"action": {"_target_": action, "scale": 1.0}},
        }
    )
    battery = load_battery(
        "planar", point="percussion", directions=4, impulses=[0.94 * impulse, 1.06 * impulse],
        starts=1, duration=0.004, start_noise=0.0, push_time=0.1, end_time=2.5,
    )  # fmt: skip
    trials = trials_of(battery, Candidate("pose_hold", cfg, None), num_envs=64)
    fell = trials.groupby("impulse")["fell"].agg(["all", "any"])
    assert not fell.iloc[:2].to_numpy().any()  # without a push, and with less
    assert fell.iloc[2].all()


def test_a_battery_scales_its_times_and_not_its_sizes(tmp_path):
    """T sqrt(h / g): the toy is 0.2525 m high and the default robot 0.22 m."""
    later = math.sqrt(0.2525 / 0.22)
    cfg = compose_config(["num_envs=4"]).env
    toy = {"_target_": "zfall.robots.Robot", "name": "toy", "mjcf": str(toy_mjcf(tmp_path))}
    OmegaConf.update(cfg, "base_env.robot", toy, force_add=True)
    cfg.base_env.servos = None
    result = evaluate("pose_hold", "planar", env=cfg, starts=1, directions=1, impulses=[0.1])
    pushed = result.trials[result.trials["impulse"] > 0].iloc[0]
    assert pushed["duration_s"] == pytest.approx(0.1 * later, abs=1e-3)
    impulse = pushed["force_n"] * pushed["duration_s"]
    np.testing.assert_allclose(impulse, 0.1 * 2.5 * math.sqrt(9.81 * 0.2525), rtol=1e-3)
    push = cfg.transforms.push
    assert push.duration == pytest.approx(0.1 * later, rel=1e-3)
    assert list(push["size"]) == [0.3, 0.5]
