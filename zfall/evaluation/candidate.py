"""What a battery tests: a run's policy in its env, or a baseline; and where its trials are kept."""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from omegaconf import DictConfig, OmegaConf

from zfall import checkpoint
from zfall.configs import compose_config
from zfall.envs.tables import changed, env_digest, keep, robot_of
from zfall.evaluation.battery import starts_and_pushes
from zfall.evaluation.definitions import Battery
from zfall.evaluation.metrics import MEASURES
from zfall.fingerprints import weights_digest
from zfall.policies.load import checkpoint_of, policy_of, shipped
from zfall.robots import Robot

SCRIPTED = ("scripted_kneel", "scripted_catch")  # act by themselves in an env with modes
BASELINES = ("pose_hold", "limp", *SCRIPTED)


@dataclass(frozen=True)
class Tested:
    """A policy or baseline under test.

    Args:
        name: a run folder, or the name of a baseline or of a policy that ships.
        env_cfg: config of its env.
        actor: the policy; ``None`` for a baseline.
        folder: where its results go.
        weights: digest of the policy.
    """

    name: str
    env_cfg: DictConfig
    actor: torch.nn.Module | None
    folder: Path
    weights: str

    @classmethod
    def load(cls, cfg: DictConfig, name: str, output: Path, setting: str) -> "Tested":
        """From its folder, or for a baseline by its name; ``setting`` names its results."""
        env_cfg, actor = load_run(cfg, name)
        for kept in set(cfg.keep) & set(starts_and_pushes(env_cfg)):
            raise ValueError(f"keep must not name {kept}: a battery has its own starts and pushes.")
        place = Path(name)
        if name in BASELINES or shipped(name).exists():
            place = output / name if cfg.runs is not None else output
        folder = place / "evaluation" / setting
        return cls(name, keep(env_cfg, cfg.keep), actor, folder, weights_digest(actor))

    @property
    def robot(self) -> Robot:
        """The robot of its env."""
        return robot_of(self.env_cfg)

    @property
    def servos(self) -> bool:
        """Whether the servos act."""
        return self.name != "limp"

    def asked(self, battery: Battery, cfg: DictConfig) -> dict[str, Any]:
        """All that the outcomes follow from: results of the same are the same."""
        asked = {
            "baseline": self.name if self.actor is None else None,
            "weights": self.weights,
            "seed": cfg.seed,
            "measures": MEASURES,
            "keep": list(cfg.keep),
            "definition": json.loads(json.dumps(asdict(battery))),
            "env": OmegaConf.to_yaml(self.env_cfg, resolve=True),
            "world": env_digest(self.env_cfg),
        }
        if cfg.keep:  # noise and delays are drawn for all worlds that run together
            asked["num_envs"] = cfg.num_envs
        return asked


def load_run(cfg: DictConfig, run: str) -> tuple[DictConfig, torch.nn.Module | None]:
    """The env's config, and the policy; none for a baseline.

    Raises:
        ValueError: if the folder holds no checkpoint, or one that does not fit.
    """
    if run in BASELINES:
        given = cfg.get("env") or (
            "push_to_kneel" if cfg.get("battery") == "kneel" else "push_recovery"
        )
        if isinstance(given, str):
            given = compose_config([f"env={given}", "num_envs=64"]).env
        given = changed(given, cfg.get("change", []))
        return scripted(given, run) if run in SCRIPTED else held(given), None
    path = checkpoint_of(run, cfg.checkpoint, others=BASELINES)
    content = checkpoint.load(path)
    env_cfg = changed(OmegaConf.create(content["config"]).env, cfg.get("change", []))
    return env_cfg, policy_of(content, env_cfg, path)


def scripted(env_cfg: DictConfig, run: str) -> DictConfig:
    """The env's config for a baseline that kneels by itself.

    ``scripted_kneel`` goes from the stand to the pose ``kneel``, whatever the fall;
    ``scripted_catch`` through the movements that ``recipes.falling.catches`` found.

    Raises:
        ValueError: if the env has no modes.
    """
    if env_cfg.transforms.get("kneel_reference") is None:
        raise ValueError(f"{run} needs an env with modes: env=push_to_kneel.")
    new = without_exploration(env_cfg)
    if run == "scripted_kneel":  # nothing is fast enough for another movement
        OmegaConf.update(new, "transforms.kneel_reference.moving", math.inf, force_add=True)
    return new


def without_exploration(env_cfg: DictConfig) -> DictConfig:
    """The env's config with modes to which rest is rest, not what exploration leaves of it."""
    new = env_cfg.copy()
    for key in ("rest_speed", "rest_joint_speed"):  # [m/s and rad/s]
        OmegaConf.update(new, f"transforms.mode.{key}", 0.1, force_add=True)
    return new


def held(env_cfg: DictConfig) -> DictConfig:
    """The env's config for a baseline that does nothing: with modes it would kneel by script."""
    if env_cfg.transforms.get("kneel_reference") is None:
        return env_cfg
    alone = ["transforms.kneel_reference=null"]
    if env_cfg.transforms.get("mirrored_falls") is not None:  # it works with the one above
        alone += ["transforms.mirrored_falls=null"]
    return changed(env_cfg, alone)


def begins_kneeling(env_cfg: DictConfig) -> bool:
    """Whether episodes of a training begin in mode KNEEL, and so the memory of its policy."""
    return bool(OmegaConf.select(env_cfg, "transforms.mode.initial") == "kneel")


def write_trials(path: Path, trials: pd.DataFrame, asked: dict[str, Any]) -> None:
    """Writes trials, and beside them what was asked for; never half a row."""
    given = path.with_suffix(".json")
    given.unlink(missing_ok=True)  # trials without it count for nothing
    trials.to_csv(path.with_suffix(".tmp"), index=False)
    path.with_suffix(".tmp").replace(path)
    path.with_suffix(".tmp").write_text(json.dumps(asked))
    path.with_suffix(".tmp").replace(given)


def read_trials(path: Path, asked: dict[str, Any]) -> pd.DataFrame | None:
    """Trials that were written for the same; ``None`` if there are none."""
    given = path.with_suffix(".json")
    if not (path.exists() and given.exists()) or json.loads(given.read_text()) != asked:
        return None
    return pd.read_csv(path)
