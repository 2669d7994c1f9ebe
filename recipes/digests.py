"""What tells a world, a training or a policy from all others."""

import hashlib
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from zfall.envs.model import identity_of
from zfall.evaluation.battery import robot_of

ASSETS = Path(str(files("zfall.envs"))) / "assets"
MOVEMENTS = ASSETS / "zeroth01_catches.npz"
# Files whose content a world depends on: what reads them, the key that may name another one, and
# how the name of the robot's own ends, beside its MJCF.
READ_BY: dict[str, tuple[str | None, str]] = {
    "KneelReference": ("catches", "catches.npz"),
    "FallingStart": ("bank", "falls.npz"),
    "load_fall_network": ("path", "fall_network.pt"),
    "ReferenceStart": (None, "motions.npz"),
}


def digest(value: Any) -> str:
    """Twelve digits that tell a value from all others."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:12]


def file_digest(path: Path) -> str:
    """Tells the content of a file from all others."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def weights_digest(actor: torch.nn.Module | None) -> str:
    """Tells the weights of a policy from those of any other."""
    values = [] if actor is None else actor.state_dict().values()
    return hashlib.sha256(b"".join(value.numpy().tobytes() for value in values)).hexdigest()


def env_digest(env_cfg: DictConfig) -> str:
    """Tells a world from all others, by its config, its robot, and the files it reads."""
    text, robot = OmegaConf.to_yaml(env_cfg, resolve=True), robot_of(env_cfg)
    read: dict[str, str] = {}
    for node in _targets(OmegaConf.to_container(env_cfg, resolve=True)):
        name = node["_target_"].rpartition(".")[2]
        if name not in READ_BY:
            continue
        key, ending = READ_BY[name]
        own = Path(robot.mjcf).with_name(f"{robot.name}_{ending}")
        path = Path(node.get(key) or own) if key else own
        if name == "load_fall_network" and not path.exists():
            path = own.with_name(str(path))  # one of those that ship, by its name
        if path.exists():  # else its reader says so
            read[name] = read.get(name, "") + file_digest(path)
    return digest({"env": text, "robot": identity_of(robot), "files": read})


def _targets(value: Any) -> list[dict[str, Any]]:
    """All parts of a config that name a class or function."""
    if isinstance(value, list):
        return [node for entry in value for node in _targets(entry)]
    if not isinstance(value, dict):
        return []
    own = [value] if isinstance(value.get("_target_"), str) else []
    return own + [node for entry in value.values() for node in _targets(entry)]
