"""Policies from run folders and those that ship."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from torchrl.envs import TransformedEnv

from zfall import checkpoint as checkpoints
from zfall.envs.tables import changed, check_same_interface, robot_of
from zfall.modules.memory import carry_memory
from zfall.policies.foreign import read_foreign
from zfall.simulation.model import identity_of
from zfall.trust import trusting

POLICIES = Path(str(files("zfall"))) / "policies"  # that ship with the package
# Who reads a policy that is a file of its own, by the ending of its name: actor and config.
Reader = Callable[[Path, Sequence[str]], tuple[torch.nn.Module, DictConfig]]
READERS: Mapping[str, Reader] = {".yaml": read_foreign, ".yml": read_foreign}


@dataclass(frozen=True)
class Policy:
    """A trained policy and the task it was trained in.

    Attributes:
        name: a run folder, the name of a policy that ships, or a yaml.
        actor: reads ``observation`` ``(*B, D)`` and hidden states, writes ``action`` ``(*B, J)``.
        config: of its training: ``env``, ``actor`` and the rest, with what ``changes`` replaced.
        card: what is known of it, in Markdown; empty of a run folder.
    """

    name: str
    actor: torch.nn.Module
    config: DictConfig
    card: str

    def env(self, num_envs: int = 1, *, training: bool = False) -> TransformedEnv:
        """Its task with this many worlds.

        Args:
            num_envs: number of worlds N.
            training: whether pushes, noise, delays and randomisation of the training act.
        """
        env = instantiate(self.config.env, base_env={"num_envs": num_envs}, training=training)
        carry_memory(env, self.actor)
        return env


def load_policy(
    run: str | Path,
    *,
    checkpoint: str = "last",
    changes: Sequence[str] = (),
    trust: Sequence[str] = (),
) -> Policy:
    """A policy by its name: ``load_policy("best")``, or of a run folder.

    Args:
        run: a run folder, the name of a policy that ships, or the yaml of one of another
            framework, see ``zfall.policies.foreign``; as a ``Path`` also the file of a checkpoint.
        checkpoint: of a run folder, ``last``, ``best``, or a stage of it that is over.
        changes: values of its env to replace, ``["transforms.mode.angle=0.4"]``.
        trust: modules of one's own that its config may name, ``["my_terms"]``; their code is run.

    Raises:
        ValueError: if there is no such policy, its checkpoint is damaged, does not fit or names
            what is not trusted, or a change names nothing.
    """
    of = checkpoint_or_file if isinstance(run, Path) else checkpoint_of
    path = of(str(run), checkpoint)
    with trusting(trust):
        actor, config = READERS.get(path.suffix, _read_checkpoint)(path, changes)
    card = path.with_suffix(".md")
    text = card.read_text() if path.parent == POLICIES and card.is_file() else ""
    return Policy(str(run), actor, config, text)


def _read_checkpoint(path: Path, changes: Sequence[str]) -> tuple[torch.nn.Module, DictConfig]:
    content = checkpoints.load(path)
    config = OmegaConf.create(content["config"])
    config.env = changed(config.env, changes)
    return policy_of(content, config.env, path), config


def checkpoint_of(
    run: str, name: str = "last", *, key: str = "run", others: Sequence[str] = ()
) -> Path:
    """The file of a run folder's policy, of one that ships, or of one that is a file of its own.

    Args:
        run: the folder, or the name of the policy.
        name: of the checkpoint: ``last``, ``best``, or a stage of that run that is over.
        key: what to call it, should there be none.
        others: what else may stand there.

    Raises:
        ValueError: if there is neither.
    """
    if not isinstance(run, str):
        raise ValueError(f"{key} must be the name of one folder or policy, got {run}.")
    path, names = shipped(run), ["last", "best"]
    own = Path(run)
    path = own if own.suffix in READERS and own.is_file() else path
    if path.is_file():
        _check_named(name, names, run)
        return path
    if own.is_file():
        raise ValueError(
            f"{key} must be a run folder, a policy that ships or the yaml of one from elsewhere, "
            f"got the file {run}; docs/guide/policies-from-elsewhere.md has such a yaml."
        )
    if not Path(run).is_dir():
        ship = sorted(policy.stem for policy in POLICIES.glob("*.pt"))
        what = "file" if own.suffix in READERS else "folder"
        raise ValueError(
            f"{key} must be a run folder, or one of {', '.join((*others, *ship))}; "
            f"there is no {what} {run}."
        )
    check_holds_run(Path(run), key)
    stages = {file.stem for file in Path(run).glob("checkpoints/*.pt")} - {*names}
    _check_named(name, [*names, *sorted(stages)], run)
    return Path(run) / "checkpoints" / f"{name}.pt"


def checkpoint_or_file(run: str, name: str = "last", *, key: str = "run") -> Path:
    """As ``checkpoint_of``; ``run`` may also be the file of a checkpoint, of a stage perhaps."""
    path = Path(run)
    return path if path.suffix == ".pt" and path.is_file() else checkpoint_of(run, name, key=key)


def config_value(run: str, key: str) -> Any:
    """A value of the config of a run folder's policy, of one that ships, or of a checkpoint's file.

    Args:
        run: as ``checkpoint_or_file`` takes it.
        key: full, ``env.base_env.control_dt``.

    Raises:
        ValueError: if there is no such policy, or it has no such value.
    """
    path = checkpoint_or_file(run, key="policy")
    value = OmegaConf.select(_config_of(path, path.stat().st_mtime_ns), key)
    if value is None:
        raise ValueError(f"the policy must have {key} in its config, {run} has none.")
    return value


@lru_cache(maxsize=4)
def _config_of(path: Path, written: int) -> DictConfig:
    """The config of a checkpoint, read once as long as nothing is written anew."""
    return OmegaConf.create(checkpoints.load(path)["config"])


def _check_named(name: str, names: Sequence[str], run: str) -> None:
    if name not in names:
        raise ValueError(f"checkpoint must be {' or '.join(names)} of {run}, got {name}.")


def check_holds_run(folder: Path, key: str) -> None:
    """Refuses a folder that holds no checkpoint, naming the newest run below it.

    Recipes write into the folder of a run that they read: it must not lead to files elsewhere.

    Raises:
        ValueError: if there is no such folder, it is not that of a run, or a link leads out of it.
    """
    if (folder / "checkpoints").is_dir():
        inside = folder.resolve()
        for path in folder.rglob("*"):
            real = path.resolve()
            if real.is_relative_to(inside) and (real.is_file() or real.is_dir()):
                continue
            if path.is_symlink() or path.exists():  # else it was just taken away
                raise ValueError(
                    f"{key} must be a run folder of plain files, {path} is none of it: "
                    "put the file itself there, or remove it."
                )
        return
    if not folder.is_dir():
        raise ValueError(f"{key} must be a run folder, there is no folder {folder}.")
    below = [path for depth in ("*", "*/*") for path in folder.glob(f"{depth}/checkpoints")]
    newest = max(below, key=lambda path: path.stat().st_mtime, default=folder).parent
    hint = f"; the newest run in it is {newest}" if below else ""
    raise ValueError(f"{key} must be a run folder, {folder} has no checkpoints{hint}.")


def shipped(name: str) -> Path:
    """File of a policy that ships with the package."""
    return POLICIES / f"{name}.pt"


def policy_of(content: dict[str, Any], env_cfg: DictConfig, path: Path) -> torch.nn.Module:
    """The policy of a checkpoint, for the env of this config; raises if it does not fit."""
    config = OmegaConf.create(content["config"])
    with checkpoints.reading(path):
        env = instantiate(env_cfg, base_env={"num_envs": 1})
        specs = (env.observation_spec, env.action_spec)
        actor: torch.nn.Module = instantiate(config.actor, *specs)
        checkpoints.check_fits(content, identity_of(env.base_env.robot), actor, path)
        actor.load_state_dict(content["policy"])
    return actor


def read_teacher(
    run: object, pupil: DictConfig, key: str, sees: str = "observation"
) -> torch.nn.Module:
    """The policy of a run, for a training by the config of the ``pupil`` to learn from.

    Args:
        run: a run folder, the name of a policy that ships, or the file of a checkpoint.
        pupil: config of the training.
        key: where the run is named, for messages.
        sees: the vector of the pupil's env that the teacher is shown as its ``observation``.

    Raises:
        ValueError: if there is no such run, or its policy sees or does something else.
    """
    if not (isinstance(run, str) and run):
        raise ValueError(f"{key} must be a run folder or a policy that ships, got {run!r}.")
    path = checkpoint_or_file(run, key=key)
    content = checkpoints.load(path)
    cfg = OmegaConf.create(content["config"])
    seen = {} if sees == "observation" else {"this run": sees}
    check_same_interface({run: cfg, "this run": pupil}, sees=seen)
    robot = identity_of(robot_of(pupil.env))
    if content["robot"] != robot:
        raise ValueError(f"{key} must be of the robot {robot}, {run} is of {content['robot']}.")
    return policy_of(content, cfg.env, path)
