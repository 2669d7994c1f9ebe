"""Builds the page in which one pushes the robot: ``python -m recipes.playground out=DIR``.

One static folder: MuJoCo and onnxruntime in WebAssembly, three.js, the robot and the policy. Any
web server can serve it, and the browser needs nothing from elsewhere.
"""

import json
from pathlib import Path
from typing import Any, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import remove_if_empty, shown_path
from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Name

from .shell import Changes, Checkpoint, Run, check_recipe, one_line_errors, start

SOURCES = Path(__file__).parents[1] / "playground"


class Keys(TypedDict):
    """The keys of ``playground.yaml``."""

    out: Name
    run: Run
    checkpoint: Checkpoint
    trust: Changes
    change: Changes


@hydra.main(version_base=None, config_path=".", config_name="playground")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes the folder."""
    output = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, Keys)
        from zfall.policies.page_files import check_folder, copy_page

        out = Path(cfg.out)
        check_folder(out, SOURCES)
    with one_line_errors(), trusting(cfg.trust):
        from zfall.evaluation.battery import battery_env
        from zfall.evaluation.candidate import load_candidate
        from zfall.evaluation.definitions import load_battery
        from zfall.policies.export import describe, export
        from zfall.policies.on_robot import RobotPolicy
        from zfall.policies.webpage import (
            check_measurable,
            describe_look,
            describe_robot,
            robot_mjcf,
        )

        policy = load_candidate(cfg.run, checkpoint=cfg.checkpoint, change=cfg.change)
        if policy.actor is None:
            raise ValueError(f"run must hold a policy, {cfg.run} is a baseline.")
        battery = load_battery("planar")
        env, _, _ = battery_env(battery, policy.env_cfg, 1)
        mjcf, robot = robot_mjcf(env.base_env), describe_robot(env.base_env)
        robot_policy = RobotPolicy(env, policy.actor)
        about = describe(env, robot_policy, policy.env_cfg)
        check_measurable(about)
        copy_page(out, SOURCES)
        inputs, outputs = robot_policy.inputs, robot_policy.outputs
        export(robot_policy, out / "policy.onnx", inputs=inputs, outputs=outputs)
    standing = {"max_tilt_rad": battery.max_tilt, "min_height": battery.min_height}
    about |= {"policy": policy.label, "checkpoint": cfg.checkpoint}
    about |= {"physics_dt_s": env.base_env.physics_dt}
    (out / "robot.xml").write_text(mjcf)
    write_json(out / "policy.json", about)
    write_json(out / "look.json", describe_look(env.base_env))
    write_json(out / "robot.json", robot | {"standing": standing})
    remove_if_empty(output)
    print(f"wrote {shown_path(out)}")
    print(f"to see it: python -m http.server --directory {shown_path(out)} 8000")


def write_json(path: Path, content: Any) -> None:
    """Writes what a page reads."""
    path.write_text(json.dumps(content))


if __name__ == "__main__":
    start(main)
