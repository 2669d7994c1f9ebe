"""What a battery tests: a run's policy in its env, or a baseline; and where its trials are kept."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from hydra import compose
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from recipes.digests import env_digest, weights_digest
from zfall import checkpoint
from zfall.envs.model import identity_of
from zfall.envs.robots import Robot
from zfall.evaluation.battery import robot_of, starts_and_pushes
from zfall.evaluation.definitions import Battery
from zfall.evaluation.metrics import MEASURES

SCRIPTED = ("scripted_kneel", "scripted_catch")  # act by themselves in an env with modes
BASELINES = ("pose_hold", "limp", *SCRIPTED)
POLICIES = Path(str(files("zfall"))) / "policies"  # that ship with the package


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
        if name in BASELINES or _shipped(name).exists():
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
            given = compose("train", overrides=[f"env={given}", "num_envs=64"]).env
        given = changed(given, cfg.get("change", []))
        return scripted(given, run) if run in SCRIPTED else held(given), None
    path = checkpoint_of(run, cfg.checkpoint, others=BASELINES)
    content = checkpoint.load(path)
    env_cfg = changed(OmegaConf.create(content["config"]).env, cfg.get("change", []))
    return env_cfg, policy_of(content, env_cfg, path)


def policy_of(content: dict[str, Any], env_cfg: DictConfig, path: Path) -> torch.nn.Module:
    """The policy of a checkpoint, for the env of this config; raises if it does not fit."""
    env = instantiate(env_cfg, base_env={"num_envs": 1})
    actor_cfg = OmegaConf.create(content["config"]).actor
    actor: torch.nn.Module = instantiate(actor_cfg, env.observation_spec, env.action_spec)
    checkpoint.check_fits(content, identity_of(env.base_env.robot), actor, path)
    actor.load_state_dict(content["policy"])
    return actor


def read_teacher(run: object, pupil: DictConfig, key: str) -> torch.nn.Module:
    """The policy of a run, for a training by the config of the ``pupil`` to learn from.

    Raises:
        ValueError: if there is no such run, or its policy sees or does something else; ``key`` is
            where it is named.
    """
    if not (isinstance(run, str) and run):
        raise ValueError(f"{key} must be a run folder or a policy that ships, got {run!r}.")
    path = checkpoint_of(run, key=key)
    content = checkpoint.load(path)
    cfg = OmegaConf.create(content["config"])
    check_same_interface({run: cfg, "this run": pupil})
    robot = identity_of(robot_of(pupil.env))
    if content["robot"] != robot:
        raise ValueError(f"{key} must be of the robot {robot}, {run} is of {content['robot']}.")
    return policy_of(content, cfg.env, path)


def scripted(env_cfg: DictConfig, run: str) -> DictConfig:
    """The env's config for a baseline that kneels by itself.

    ``scripted_kneel`` goes from the stand to the pose ``kneel``, whatever the fall;
    ``scripted_catch`` through the movements that ``recipes.catches`` found.

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


INTERFACE = ("action", "observation")  # transforms by which a policy acts and sees


def begins_kneeling(env_cfg: DictConfig) -> bool:
    """Whether episodes of a training begin in mode KNEEL, and so the memory of its policy."""
    return bool(OmegaConf.select(env_cfg, "transforms.mode.initial") == "kneel")


def check_same_interface(configs: dict[str, DictConfig]) -> None:
    """Refuses policies, by name the config of each, that do not see or do the same.

    Raises:
        ValueError: naming what differs.
    """
    names = " and ".join(configs)
    for key in (*(f"transforms.{name}" for name in INTERFACE), "base_env.control_dt"):
        values = [OmegaConf.select(cfg.env, key) for cfg in configs.values()]
        if any(value != values[0] for value in values):
            key, values = _where_they_differ(key, values)
            found = " and ".join(map(str, values))
            raise ValueError(f"{names} must have the same env.{key}, got {found}.")


def _where_they_differ(key: str, values: list[Any]) -> tuple[str, list[Any]]:
    """The first key inside of configs that are not equal whose values differ, and these."""
    while all(isinstance(value, DictConfig) for value in values):
        inside = dict.fromkeys(str(name) for value in values for name in value)
        found = {name: [value.get(name, "nothing") for value in values] for name in inside}
        differing = (n for n, those in found.items() if any(x != those[0] for x in those))
        name = next(differing, None)
        if name is None:
            break
        key, values = f"{key}.{name}", found[name]
    return key, values


def checkpoint_of(
    run: str, name: str = "last", *, key: str = "run", others: Sequence[str] = ()
) -> Path:
    """The file of a run folder's policy, or of one that ships.

    Args:
        run: the folder, or the name of the policy.
        name: of the checkpoint, ``last`` or ``best``.
        key: what to call it, should there be none.
        others: what else may stand there.

    Raises:
        ValueError: if there is neither.
    """
    if name not in ("last", "best"):
        raise ValueError(f"checkpoint must be last or best, got {name}.")
    if not isinstance(run, str):
        raise ValueError(f"{key} must be the name of one folder or policy, got {run}.")
    path = _shipped(run)
    if path.exists():
        return path
    if not Path(run).is_dir():
        ship = sorted(policy.stem for policy in POLICIES.glob("*.pt"))
        raise ValueError(
            f"{key} must be a run folder, or one of {', '.join((*others, *ship))}; "
            f"there is no folder {run}."
        )
    check_holds_run(Path(run), key)
    return Path(run) / "checkpoints" / f"{name}.pt"


def check_holds_run(folder: Path, key: str) -> None:
    """Refuses a folder that holds no checkpoint, naming the newest run below it.

    Raises:
        ValueError: if there is no such folder, or it is not that of a run.
    """
    if (folder / "checkpoints").is_dir():
        return
    if not folder.is_dir():
        raise ValueError(f"{key} must be a run folder, there is no folder {folder}.")
    below = [path for depth in ("*", "*/*") for path in folder.glob(f"{depth}/checkpoints")]
    newest = max(below, key=lambda path: path.stat().st_mtime, default=folder).parent
    hint = f"; the newest run in it is {newest}" if below else ""
    raise ValueError(f"{key} must be a run folder, {folder} has no checkpoints{hint}.")


def changed(env_cfg: DictConfig, changes: Sequence[str]) -> DictConfig:
    """The env's config with some of its values replaced, ``transforms.mode.angle=0.4``.

    Raises:
        ValueError: on a key that is not there, or something else than a list.
    """
    if isinstance(changes, str) or not isinstance(changes, Sequence):
        raise ValueError(f"change must be a list, [{changes}], got {changes}.")
    for change in map(str, changes):
        key = change.partition("=")[0]
        if OmegaConf.select(env_cfg, key, default="missing") == "missing":
            raise ValueError(f"change must name a value of the env, there is no {key}.")
    new = env_cfg.copy()  # keeps what it refers to outside of itself
    for change in map(str, changes):
        key = change.partition("=")[0]
        OmegaConf.update(new, key, OmegaConf.select(OmegaConf.from_dotlist([change]), key))
    return new


def _shipped(name: str) -> Path:
    """File of a policy that ships with the package."""
    return POLICIES / f"{name}.pt"


def keep(env_cfg: DictConfig, names: Sequence[str]) -> DictConfig:
    """The env's config with some of what evaluation leaves out kept on: noise, delays.

    Raises:
        ValueError: on a name that is not left out.
    """
    training_only = OmegaConf.select(env_cfg, "training_only", default={})
    unknown = [name for name in names if name not in training_only]
    if unknown:
        raise ValueError(
            f"keep must name what evaluation leaves out ({', '.join(training_only)}), "
            f"got {unknown[0]}."
        )
    kept = env_cfg.copy()
    for name in names:
        kept.training_only[name] = False
    return kept


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
