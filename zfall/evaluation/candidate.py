"""What is put to a battery: a policy in its env, or a baseline; and its trials on disk."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from omegaconf import DictConfig, OmegaConf

from zfall.configs import compose_config, plain_containers
from zfall.envs import tables
from zfall.envs.make import left_out
from zfall.envs.tables import changed, contents_of, robot_of
from zfall.envs.worlds import World, in_world, privileged, replaced
from zfall.evaluation.baselines import baseline_names, load_baseline, passive
from zfall.evaluation.battery import battery_env, starts_and_pushes
from zfall.evaluation.definitions import Battery
from zfall.evaluation.metrics import MEASURES
from zfall.evaluation.run_files import read_summary, read_table, reading
from zfall.files import written_whole
from zfall.fingerprints import weights_digest
from zfall.meaning import meaning, strict
from zfall.modules.actors import recurrent_keys
from zfall.modules.memory import WithoutMemory
from zfall.policies.load import Policy, checkpoint_of, load_policy, shipped
from zfall.robots import Robot
from zfall.static_checks import check_nodes


@dataclass(frozen=True)
class Candidate:
    """A policy or baseline that is put to a battery.

    Attributes:
        name: a run folder, the name of a baseline or of a policy that ships, or a yaml.
        env_cfg: config of its env.
        actor: the policy; ``None`` of a baseline.
        servos: whether the servos act.
        kept: what of the env's ``training_only`` is left on.
        memory: whether the policy keeps what it remembers from step to step.
    """

    name: str
    env_cfg: DictConfig
    actor: torch.nn.Module | None
    servos: bool = True
    kept: tuple[str, ...] = ()
    memory: bool = True

    @property
    def robot(self) -> Robot:
        """The robot of its env."""
        return robot_of(self.env_cfg)

    @property
    def label(self) -> str:
        """The last part of its name."""
        return Path(self.name).name

    def results(self, elsewhere: Path) -> Path:
        """Where its results go: a run folder keeps its own, those of others go elsewhere."""
        shared = shipped(self.name).exists() or not Path(self.name).is_dir()
        own = self.actor is not None and not shared
        return (Path(self.name) if own else elsewhere) / "evaluation"

    def still(self) -> "Candidate":
        """Baseline ``pose_hold`` in the same env."""
        return replace(
            self, name="pose_hold", env_cfg=passive(self.env_cfg), actor=None, memory=True
        )

    def keep(self, names: Sequence[str]) -> "Candidate":
        """The same with some of what batteries leave out left on: noise, delays.

        Raises:
            ValueError: on a name that is not left out, or of a start or push.
        """
        for name in set(names) & set(starts_and_pushes(self.env_cfg)):
            raise ValueError(f"keep must not name {name}: a battery has its own starts and pushes.")
        return replace(self, env_cfg=tables.keep(self.env_cfg, names), kept=tuple(names))

    def forgetting(self) -> "Candidate":
        """The same policy with a memory that begins anew in every step.

        Raises:
            ValueError: if it has none.
        """
        if self.actor is None or not recurrent_keys(self.actor):
            raise ValueError(f"memory must be true for {self.name}, which has none.")
        return replace(self, actor=WithoutMemory(self.actor), memory=False)

    def known(self, battery: Battery) -> dict[str, Any]:
        """What a summary says of it in a battery with a world of its own.

        ``privileged``: what its policy sees that this world's sensors do not measure.
        """
        if battery.world is None:
            return {}
        if self.actor is None:
            return {"privileged": []}
        return {"privileged": privileged(battery_env(battery, self.env_cfg, 1)[0])}

    def conditions(self, battery: Battery, *, seed: int) -> dict[str, Any]:
        """All that the outcomes follow from: results under the same conditions are the same."""
        config: dict[str, Any] = strict(
            {
                "env": OmegaConf.to_container(in_world(self.env_cfg, battery.world), resolve=True),
                "battery": {battery.name: asdict(battery)},
            }
        )
        return {
            "baseline": self.name if self.actor is None else None,
            "weights": weights_digest(self.actor),
            "seed": seed,
            "measures": MEASURES,
            "keep": list(self.kept),
            **({} if self.memory else {"memory": False}),
            "config": config,
            "contents": contents_of(config),
        }


def load_candidate(
    run: str | Policy,
    *,
    checkpoint: str = "last",
    change: Sequence[str] = (),
    task: DictConfig | str = "push_recovery",
) -> Candidate:
    """A policy, or a baseline in an env.

    Args:
        run: a policy, a run folder, the name of a policy that ships or of a baseline, or the yaml
            of a policy of another framework.
        checkpoint: of a run folder, ``last``, ``best``, or a stage of it that is over.
        change: values of the env to replace.
        task: the env of a baseline: its config, or its name in ``recipes/env``.

    Raises:
        ValueError: if there is none, its checkpoint does not fit, or the baseline cannot act in
            the env.
    """
    if isinstance(run, Policy):
        return Candidate(run.name, changed(run.config.env, list(change)), run.actor)
    if run in (names := baseline_names()):
        baseline = load_baseline(run)
        if checkpoint not in ("last", "best"):
            raise ValueError(f"checkpoint must be last or best of {run}, got {checkpoint}.")
        if isinstance(task, DictConfig):
            check_nodes(plain_containers(task), "env")
        env_cfg: DictConfig = (
            compose_config([f"env={task}", "num_envs=64"]).env if isinstance(task, str) else task
        )
        world = baseline.world(changed(env_cfg, list(change)))
        return Candidate(run, world, None, servos=baseline.servos)
    checkpoint_of(run, checkpoint, others=names)  # names the baselines, should there be none
    policy = load_policy(run, checkpoint=checkpoint, changes=change)
    return Candidate(run, policy.config.env, policy.actor)


def load_candidates(
    runs: Sequence[str | Policy],
    *,
    task: DictConfig | str | None = None,
    default_task: str = "push_recovery",
    checkpoint: str = "last",
    change: Sequence[str] = (),
    keep: Sequence[str] = (),
    memory: bool = True,
    world: World | None = None,
) -> list[Candidate]:
    """Policies, each in its own world, and baselines.

    A baseline meets the world of the first policy among them in which it can act; if there is
    none, ``default_task``.

    Args:
        runs: as ``load_candidate`` takes them.
        task: the env of the baselines, if there are no others.
        default_task: theirs if none is given.
        checkpoint: of run folders.
        change: values of all envs to replace.
        keep: what of each env's ``training_only`` to leave on.
        memory: whether policies remember from step to step; else each step is their first.
        world: hardware of the battery that they are put to, if it has its own.

    Raises:
        ValueError: as ``load_candidate``; if an env is given for a policy; on a wrong ``keep``; if
            ``keep`` or ``change`` names hardware that the world replaces.
    """
    known = baseline_names()
    own = [run for run in runs if isinstance(run, Policy) or run not in known]
    if own and task is not None:
        raise ValueError(
            f"env must be given for baselines alone, {own[0]} acts in its own world "
            "(change=[...] replaces values of it)."
        )
    policies = [load_candidate(run, checkpoint=checkpoint, change=change) for run in own]
    remaining = iter(policies)
    candidates = []
    for run in runs:
        if isinstance(run, Policy) or run not in known:
            candidates.append(next(remaining))
            continue
        fits = load_baseline(run).fits
        worlds = [policy.env_cfg for policy in policies if fits(policy.env_cfg)]
        own_task = task if task is not None else next(iter(worlds), default_task)
        # It names a checkpoint of the runs beside; alone, a baseline refuses it.
        wanted = "last" if any(isinstance(run, str) for run in own) else checkpoint
        candidates.append(load_candidate(run, checkpoint=wanted, change=change, task=own_task))
    for candidate in candidates:
        gone = replaced(candidate.env_cfg, world)
        for key, named in (("keep", [*keep]), ("change", [_transform_of(x) for x in change])):
            for name in {*named} & {*gone}:
                raise ValueError(
                    f"{key} must not name {name}: the battery has hardware of its own, "
                    "battery.world.PART.NAME.KEY=VALUE changes that."
                )
    kept = [candidate.keep(keep) for candidate in candidates]
    for candidate in kept:
        _check_acts(candidate, change)
    return kept if memory else [candidate.forgetting() for candidate in kept]


def _check_acts(candidate: Candidate, change: Sequence[str]) -> None:
    """Refuses changes of transforms that the battery leaves out; without effect they mislead."""
    idle = left_out(candidate.env_cfg.get("training_only") or ())
    for name in {_transform_of(x) for x in change} & {*idle}:
        own = name in starts_and_pushes(candidate.env_cfg)
        remedy = "a battery has its own" if own else f"keep=[{name}] leaves it on"
        raise ValueError(f"change must name what acts, {name} is left out of trials: {remedy}.")


def _transform_of(change: str) -> str:
    """The transform that a change is of, ``transforms.noise.std=0`` of ``noise``."""
    parts = str(change).partition("=")[0].split(".")
    return parts[1] if parts[0] == "transforms" and len(parts) > 1 else ""


def write_trials(path: Path, trials: pd.DataFrame, conditions: dict[str, Any]) -> None:
    """Writes trials, and their conditions into a JSON file of the same name; never half a row."""
    given = path.with_suffix(".json")
    given.unlink(missing_ok=True)  # trials without it count for nothing
    with written_whole(path) as new:
        trials.to_csv(new, index=False)
    with written_whole(given) as new:
        new.write_text(json.dumps(conditions))


def read_trials(path: Path, conditions: dict[str, Any]) -> pd.DataFrame | None:
    """Trials that were written under the same conditions; ``None`` if there are none.

    A config counts by its meaning: a later version may say the same in other words.
    """
    given = path.with_suffix(".json")
    if not (path.exists() and given.exists()):
        return None
    before = read_summary(given)
    with reading(given):
        same = _meaning(before) == _meaning(conditions)
    return read_table(path) if same else None


def _meaning(conditions: Mapping[str, Any]) -> dict[str, Any]:
    """Conditions with the meaning of their config in its place."""
    rest = {key: value for key, value in conditions.items() if key not in ("config", "contents")}
    return rest | {"meaning": meaning(conditions.get("config", {}), conditions.get("contents", {}))}


def remove_trials(path: Path) -> None:
    """Removes trials and their conditions, if they are there."""
    path.unlink(missing_ok=True)
    path.with_suffix(".json").unlink(missing_ok=True)
