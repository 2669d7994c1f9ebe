"""Writes a policy for a robot: ``python -m recipes.export run=best``.

``policy.onnx`` takes ``observation`` (and ``memory``) and gives ``action`` (and ``next_memory``);
``policy.json`` says what they mean. docs/drive.py runs both with onnxruntime and MuJoCo alone.
``planar=5`` puts the exported policy to battery planar, in dm_control, beside the policy itself.
"""

import json
import logging
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.progress import Progress, TimeElapsedColumn
from torchrl.envs import TransformedEnv

from recipes.shell import one_line_errors, start
from zfall.commands import remove_if_empty, shown_path
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import ObservationVector
from zfall.envs.transforms.observations.vector import vector_spans
from zfall.envs.transforms.pushes import ScriptedPush
from zfall.errors import check_keys
from zfall.evaluation.battery import battery_env, run_battery
from zfall.evaluation.candidate import load_run
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.exported import OnnxPolicy, agreement, run_exported
from zfall.modules.deployed import deployed, zero_memory

UNITS = {
    "joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N m", "target": "rad",
    "last_action": "1", "projected_gravity": "1, base axes", "base_orientation": "1, w x y z",
    "base_angular_velocity": "rad/s, base axes", "base_linear_velocity": "m/s, world axes",
    "base_position": "m", "com_velocity": "m/s, world axes", "feet_force": "N, world axes",
    "imu_orientation": "1, w x y z, w >= 0", "command": "m/s, m/s, rad, m, rad, rad",
    "feet_contact": "0 or 1", "mode": "0 or 1: recover, kneel, stable",
}  # fmt: skip
# What transforms write that a robot has as well.
OF_TRANSFORMS = ("target", "last_action", "command", "imu_orientation", "mode")


@hydra.main(version_base=None, config_path=".", config_name="export")
def main(cfg: DictConfig) -> None:
    """Writes ``policy.onnx`` and ``policy.json``."""
    output = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_keys(cfg, {"run", "checkpoint", "change", "planar"})
        starts = cfg.planar
        if starts is not None and (type(starts) is not int or starts < 1):
            raise ValueError(
                f"planar must be a number of starts per cell, at least 1, got {starts}."
            )
        env_cfg, actor = load_run(cfg, cfg.run)
        if actor is None:
            raise ValueError(f"run must hold a policy, {cfg.run} is a baseline.")
        env, _, _ = battery_env(load_battery("planar"), env_cfg, 1)
        about = describe(env, actor, env_cfg)
        # One that ships has no folder.
        folder = Path(cfg.run) / "export" if Path(cfg.run).is_dir() else output
        folder.mkdir(exist_ok=True)
        try:
            export(actor, folder / "policy.onnx", size=about["observation_size"])
        finally:
            remove_if_empty(folder)
    (folder / "policy.json").write_text(json.dumps(about, indent=2))
    remove_if_empty(output)  # what was written lies in the run folder
    place = shown_path(folder)
    print(f"wrote {place}/policy.onnx, policy.json")
    python = shown_path(Path(sys.executable))
    print(f"to drive the robot: {python} docs/drive.py {place}/policy.onnx {place}/policy.json")
    if starts is not None:
        with one_line_errors():
            compare_planar(starts, env_cfg, actor, folder, about)


def compare_planar(
    starts: int, env_cfg: DictConfig, actor: Any, folder: Path, about: dict[str, Any]
) -> None:
    """Runs battery planar with what was exported and with the policy; writes ``planar.csv``."""
    policy = OnnxPolicy(folder / "policy.onnx", about)
    battery = load_battery("planar", starts=starts)
    with Progress(*Progress.get_default_columns(), TimeElapsedColumn()) as bar:

        def follow(name: str) -> Callable[[int, int], None]:
            line = bar.add_task(name)
            return lambda done, total: bar.update(line, completed=done, total=total)

        exported = run_exported(battery, env_cfg, policy, progress=follow("as exported"))
        own = run_battery(battery, env_cfg, actor, progress=follow("in zfall"))
    exported.assign(recovered_in_zfall=own["recovered"]).to_csv(folder / "planar.csv", index=False)
    print(agreement(battery, exported, own))
    print(f"wrote {folder}/planar.csv")


def export(actor: Any, path: Path, *, size: int) -> None:
    """Writes the policy as ONNX, for one robot at a time.

    Args:
        actor: the policy.
        path: file to write.
        size: length of the observation.

    Raises:
        ValueError: without the packages that this needs.
    """
    module, memory = deployed(actor), zero_memory(actor)
    inputs, names, out = [torch.zeros(1, size)], ["observation"], ["action"]
    if memory is not None:
        inputs, names, out = [*inputs, memory], [*names, "memory"], [*out, "next_memory"]
    for name in ("torch.onnx", "onnxscript", "onnx_ir"):
        logging.getLogger(name).setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            torch.onnx.export(
                module,
                tuple(inputs),
                str(path),
                input_names=names,
                output_names=out,
                external_data=False,
                verbose=False,
            )
    except (ModuleNotFoundError, torch.onnx.errors.OnnxExporterError) as error:
        if isinstance(error, ModuleNotFoundError) or "onnxscript" in str(error):
            raise ValueError('exporting needs: .venv/bin/pip install -e ".[export]"') from None
        raise


def describe(env: TransformedEnv, actor: Any, env_cfg: DictConfig) -> dict[str, Any]:
    """What a robot needs to know besides the network.

    Raises:
        ValueError: if the action is no position around a pose, or what is observed is computed
            by more than the physics.
    """
    base = env.base_env
    actions = [t for t in env.transform if isinstance(t, JointPositionTarget)]
    vectors = [t for t in env.transform if isinstance(t, ObservationVector)]
    own = [t for t in vectors if t.out_keys[0] == "observation"]
    if not actions or not own:
        raise ValueError("run must have position targets and an ObservationVector to be exported.")
    known = (JointPositionTarget, ScriptedPush)
    others = [type(t).__name__ for t in env.transform if t.in_keys_inv and not isinstance(t, known)]
    if others:
        raise ValueError(f"run must have no {others[0]} to be exported: it is not described.")
    spans = vector_spans(env.observation_spec, own[0].keys)
    physics = {*base.observation_spec.keys(True, True), *OF_TRANSFORMS}
    others = [str(key) for key in own[0].keys if key not in physics]
    if others:
        raise ValueError(f"run must observe what a robot can know to be exported, got {others[0]}.")
    size = int(env.observation_spec["observation"].shape[-1])
    changed = {"observation", *(("measured", key) for key in spans)}
    others = [type(t).__name__ for t in env.transform if t not in own and changed & {*t.out_keys}]
    if others or size != max(span.stop for span in spans.values()):
        name = others[0] if others else "history"
        raise ValueError(f"run must observe true quantities to be exported, got {name} as well.")
    memory = zero_memory(actor)
    low, high = base.joint_range.unbind(-1)
    return {
        "robot": base.robot.name,
        "control_dt_s": base.control_dt,
        "physics_dt_s": base.physics_dt,
        "observation_size": size,
        "observation": [
            {"name": str(key), "from": span.start, "to": span.stop, "unit": UNITS.get(key, "")}
            for key, span in spans.items()
        ],
        "memory_shape": None if memory is None else list(memory.shape),
        "joints": list(base.robot.joints),
        "target": "clip(reference + scale * action, low, high)",
        "scale_rad": float(actions[0].scale),
        "reference_rad": base.stand_position.tolist(),
        "low_rad": low.tolist(),
        "high_rad": high.tolist(),
        "config": OmegaConf.to_container(env_cfg, resolve=True),
    }


if __name__ == "__main__":
    start(main)
