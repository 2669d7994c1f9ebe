"""Builds the page in which one pushes the robot: ``python -m recipes.playground out=DIR``.

One static folder: MuJoCo and onnxruntime in WebAssembly, three.js, the robot and the policy. Any
web server can serve it, and the browser needs nothing from elsewhere.
"""

import json
import shutil
import subprocess
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
PAGE = ("index.html", "style.css", "js")
VENDOR = {  # from node_modules, to vendor/
    "@mujoco/mujoco/mujoco.js": "mujoco/mujoco.js",
    "@mujoco/mujoco/mujoco.wasm": "mujoco/mujoco.wasm",
    "onnxruntime-web/dist/ort.wasm.min.mjs": "onnxruntime/ort.wasm.min.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.mjs": "onnxruntime/ort-wasm-simd-threaded.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.wasm": "onnxruntime/ort-wasm-simd-threaded.wasm",
    "three/build/three.module.js": "three/three.module.js",
    "three/build/three.core.js": "three/three.core.js",
    "three/examples/jsm/controls/OrbitControls.js": "three/addons/controls/OrbitControls.js",
    "three/examples/jsm/geometries/RoundedBoxGeometry.js": (
        "three/addons/geometries/RoundedBoxGeometry.js"
    ),
    "three/LICENSE": "three/LICENSE",
}


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
        out = Path(cfg.out)
        check_folder(out)
    with one_line_errors(), trusting(cfg.trust):
        from zfall.evaluation.battery import battery_env
        from zfall.evaluation.candidate import load_candidate
        from zfall.evaluation.definitions import load_battery
        from zfall.policies.export import describe, export
        from zfall.policies.on_robot import RobotPolicy
        from zfall.policies.webpage import check_measurable, describe_robot, robot_mjcf

        policy = load_candidate(cfg.run, checkpoint=cfg.checkpoint, change=cfg.change)
        if policy.actor is None:
            raise ValueError(f"run must hold a policy, {cfg.run} is a baseline.")
        battery = load_battery("planar")
        env, _, _ = battery_env(battery, policy.env_cfg, 1)
        mjcf, robot = robot_mjcf(env.base_env), describe_robot(env.base_env)
        robot_policy = RobotPolicy(env, policy.actor)
        about = describe(env, robot_policy, policy.env_cfg)
        check_measurable(about)
        libraries = fetch_libraries()
        copy_page(out, libraries)
        inputs, outputs = robot_policy.inputs, robot_policy.outputs
        export(robot_policy, out / "policy.onnx", inputs=inputs, outputs=outputs)
    standing = {"max_tilt_rad": battery.max_tilt, "min_height": battery.min_height}
    about |= {"policy": policy.label, "checkpoint": cfg.checkpoint}
    about |= {"physics_dt_s": env.base_env.physics_dt}
    (out / "robot.xml").write_text(mjcf)
    write_json(out / "policy.json", about)
    write_json(out / "robot.json", robot | {"standing": standing})
    remove_if_empty(output)
    print(f"wrote {shown_path(out)}")
    print(f"to see it: python -m http.server --directory {shown_path(out)} 8000")


def check_folder(out: Path) -> None:
    """Refuses to mix the page with what it does not know, and a place without the sources."""
    if not SOURCES.is_dir():
        raise ValueError("playground must be built in a clone of the project: its pages are there.")
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not (out / "robot.json").exists()):
        raise ValueError(f"out must be a new or empty folder, or one built before, got {out}.")


def fetch_libraries() -> Path:
    """``node_modules`` with the pinned libraries, by ``npm ci`` if they are not there.

    Raises:
        ValueError: without npm, or if it fails.
    """
    folder = SOURCES / "node_modules"
    lock, done = SOURCES / "package-lock.json", folder / ".of-lock"
    if done.exists() and done.read_text() == lock.read_text():
        return folder
    if shutil.which("npm") is None:
        raise ValueError("npm must be on the PATH, for the page's libraries: install Node.js 20.")
    command = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
    ran = subprocess.run(command, cwd=SOURCES, capture_output=True, text=True, check=False)
    if ran.returncode:
        last = (ran.stderr.strip().splitlines() or ["nothing"])[-1]
        raise ValueError(f"npm ci must fetch the page's libraries, it says: {last}")
    done.write_text(lock.read_text())
    return folder


def copy_page(out: Path, libraries: Path) -> None:
    """Puts the page and its libraries into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    for name in PAGE:
        source = SOURCES / name
        copy: Any = shutil.copytree if source.is_dir() else shutil.copy
        copy(source, out / name, **({"dirs_exist_ok": True} if source.is_dir() else {}))
    for name, place in VENDOR.items():
        (out / "vendor" / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(libraries / name, out / "vendor" / place)


def write_json(path: Path, content: Any) -> None:
    """Writes what a page reads."""
    path.write_text(json.dumps(content))


if __name__ == "__main__":
    start(main)
