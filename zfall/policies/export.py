"""A policy for a robot: all that runs on its computer as ONNX, and what the numbers mean."""

import logging
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn
from torchrl.envs import TransformedEnv

from zfall.policies.exported import FORMAT
from zfall.policies.on_robot import RobotPolicy, operated, plain_name
from zfall.simulation.quantities import UNITS


def export(
    module: nn.Module, path: Path, *, inputs: Mapping[str, Tensor], outputs: Sequence[str]
) -> None:
    """Writes a network as ONNX.

    Args:
        module: takes the inputs in their order.
        path: file to write.
        inputs: names, and examples in the shapes that are exported.
        outputs: names of what it gives.

    Raises:
        ValueError: without the packages that this needs.
    """
    for name in ("torch.onnx", "onnxscript", "onnx_ir"):
        logging.getLogger(name).setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            torch.onnx.export(
                module.eval(),
                tuple(inputs.values()),
                str(path),
                input_names=list(inputs),
                output_names=list(outputs),
                external_data=False,
                custom_translation_table={torch.ops.prims.hypot.default: _hypot},
                verbose=False,
            )
    except (ModuleNotFoundError, torch.onnx.errors.OnnxExporterError) as error:
        if isinstance(error, ModuleNotFoundError) or "onnxscript" in str(error):
            raise ValueError('exporting needs: .venv/bin/pip install -e ".[export]"') from None
        raise


def _hypot(x: Any, y: Any) -> Any:
    """``torch.hypot``, which the exporter does not know, from what ONNX has."""
    from onnxscript import opset18 as onnx

    return onnx.Sqrt(onnx.Add(onnx.Mul(x, x), onnx.Mul(y, y)))


def export_policy(env: TransformedEnv, actor: Any, path: Path) -> RobotPolicy:
    """Writes all that runs on the robot's computer as ONNX, and returns it, see ``RobotPolicy``.

    Args:
        env: as the policy is used, with the starts and pushes of a battery.
        actor: the policy.
        path: file to write.

    Raises:
        ValueError: see ``export`` and ``RobotPolicy``.
    """
    policy = RobotPolicy(env, actor)
    export(policy, path, inputs=policy.inputs, outputs=policy.outputs)
    return policy


def describe(env: TransformedEnv, policy: RobotPolicy, env_cfg: DictConfig) -> dict[str, Any]:
    """What a robot needs to know besides the network: the content of ``policy.json``.

    Units are those of the base env's quantities, and those that transforms declare in ``units``.

    Args:
        env: of the policy.
        policy: what was exported.
        env_cfg: config of the env.
    """
    base, given = env.base_env, operated(env)
    declared = {key: unit for t in env.transform for key, unit in getattr(t, "units", {}).items()}
    units = dict.fromkeys(base.observation_spec.keys(True, True), "") | UNITS | declared
    low, high = base.joint_range.unbind(-1)
    with torch.no_grad():
        command = policy(*policy.inputs.values())[1]
    return {
        "format": FORMAT,
        "robot": base.robot.name,
        "control_dt_s": base.control_dt,
        "ticks": command.shape[1],
        "joints": list(base.robot.joints),
        "reference_rad": base.stand_position.tolist(),
        "low_rad": low.tolist(),
        "high_rad": high.tolist(),
        "kp": [base.servos[j].kp for j in base.robot.joints] if base.servos else None,
        "sensors": [
            {
                "name": plain_name(key),
                "size": shape.numel(),
                "unit": units.get(key, ""),
                "by": "operator" if key in given else "robot",
            }
            for key, shape in policy.shapes.items()
        ],
        "states": {name: start.tolist() for name, start in policy.starts.items()},
        "observation": [
            {"name": name, "from": span.start, "to": span.stop, "unit": units.get(name, "")}
            for name, span in policy.spans.items()
        ],
        "config": OmegaConf.to_container(env_cfg, resolve=True),
    }
