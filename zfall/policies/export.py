"""A policy for a robot: its network as ONNX, and what the numbers mean."""

import logging
import warnings
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from torchrl.envs import TransformedEnv

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import ObservationVector
from zfall.envs.transforms.observations.vector import vector_spans
from zfall.envs.transforms.pushes import ScriptedPush
from zfall.modules.deployed import deployed, memories_at_start
from zfall.simulation.quantities import UNITS


def export(actor: Any, path: Path, *, size: int) -> None:
    """Writes the policy as ONNX, for one robot at a time.

    It takes ``observation`` ``(1, size)``, and ``memory`` if the policy has one, and gives
    ``action`` ``(1, J)``, and ``next_memory``. A policy with several memories has an input for
    each, see ``memories_at_start``, and gives each with ``next_`` in front.

    Args:
        actor: the policy.
        path: file to write.
        size: length of the observation.

    Raises:
        ValueError: without the packages that this needs, or for a policy without a plain form.
    """
    module, memories = deployed(actor), memories_at_start(actor)
    inputs = [torch.zeros(1, size), *memories.values()]
    names = ["observation", *memories]
    out = ["action", *(f"next_{name}" for name in memories)]
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
    """What a robot needs to know besides the network: the content of ``policy.json``.

    Units are those of the base env's quantities, and those that transforms declare in ``units``,
    by key: what a transform writes and a robot has as well, its last action for instance.

    Args:
        env: as the policy is used, with the starts and pushes of a battery.
        actor: the policy.
        env_cfg: config of the env.

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
    declared = {key: unit for t in env.transform for key, unit in getattr(t, "units", {}).items()}
    units = dict.fromkeys(base.observation_spec.keys(True, True), "") | UNITS | declared
    others = [str(key) for key in own[0].keys if key not in units]
    if others:
        raise ValueError(f"run must observe what a robot can know to be exported, got {others[0]}.")
    size = int(env.observation_spec["observation"].shape[-1])
    changed = {"observation", *(("measured", key) for key in spans)}
    others = [type(t).__name__ for t in env.transform if t not in own and changed & {*t.out_keys}]
    if others or size != max(span.stop for span in spans.values()):
        name = others[0] if others else "history"
        raise ValueError(f"run must observe true quantities to be exported, got {name} as well.")
    memories = {name: list(start.shape) for name, start in memories_at_start(actor).items()}
    only = {"memory_shape": memories.get("memory")} if len(memories) < 2 else {}
    low, high = base.joint_range.unbind(-1)
    return {
        "robot": base.robot.name,
        "control_dt_s": base.control_dt,
        "physics_dt_s": base.physics_dt,
        "observation_size": size,
        "observation": [
            {"name": str(key), "from": span.start, "to": span.stop, "unit": units[key]}
            for key, span in spans.items()
        ],
        **only,
        "memories": memories,
        "joints": list(base.robot.joints),
        "target": "clip(reference + scale * action, low, high)",
        "scale_rad": float(actions[0].scale),
        "reference_rad": base.stand_position.tolist(),
        "low_rad": low.tolist(),
        "high_rad": high.tolist(),
        "config": OmegaConf.to_container(env_cfg, resolve=True),
    }
