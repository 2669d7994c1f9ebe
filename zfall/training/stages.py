"""A training in several stages: the config of each, and where each begins."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omegaconf import DictConfig, OmegaConf

from zfall import checkpoint
from zfall.errors import SPOKEN, at, in_one_line
from zfall.training.keys import TrainKeys
from zfall.training.learner import Learner
from zfall.training.ranks import ALONE, Ranks
from zfall.training.trial_step import try_one_step
from zfall.training.warm_start import warm_start

# Keys that are the run's.
OF_THE_RUN = (
    *("stages", "experiment", "resume", "trust", "name", "logger", "showcase"),
    "checkpoint_every",
)
_LINK = "stage:"  # and the name of one: what that came to
_TAKEN = ("last", "best")  # checkpoints that every run has


@dataclass(frozen=True)
class Stage:
    """A part of a training.

    Attributes:
        name: of the stage; None of a training that has none.
        number: from 1 on; 0 of a training that has none.
        config: of a training by itself.
        begins_with: the stage before it with whose weights it begins, if any.
        keeps_deviation: whether it explores as much as that one did at its end: if both have the
            same ``actor.std``.
    """

    name: str | None
    number: int
    config: DictConfig
    begins_with: str | None = None
    keeps_deviation: bool = True


def stages_of(cfg: DictConfig) -> list[Stage]:
    """The stages of a training in their order, or the training itself as the only one.

    Each is the config with the stage's values in place of its own. A stage begins with the weights
    of the one before it, or as its ``warm_start`` says: with those of another one before it,
    ``stage:NAME``, of a run or policy, or with none (``null``). Wherever else a policy is named,
    ``stage:NAME`` is what a stage before it came to. A stage that is null is left out.

    Raises:
        ValueError: on a stage that is neither a table nor null, a name that it cannot have, or a
            key that is that of the whole run.
    """
    if not cfg.get("stages"):
        return [Stage(None, 0, cfg)]
    base = OmegaConf.to_container(cfg, resolve=False)
    assert isinstance(base, dict)
    stages = base.pop("stages")
    made: list[Any] = []
    before: dict[str, Stage] = {}
    for name, changes in stages.items():
        _check(name, changes)
        if changes is None:
            continue
        merged = {**_changed(base, changes), "stages": {}}
        start = changes.get("warm_start", _LINK + made[-1].name if made else cfg.warm_start)
        _check_links({**merged, "warm_start": start}, before, f"stages.{name}")
        linked = before[start.removeprefix(_LINK)] if _is_link(start) else None
        merged["warm_start"] = None if linked else start
        config = OmegaConf.create(merged)
        keeps = linked is not None and linked.config.actor.get("std") == config.actor.get("std")
        made.append(Stage(name, len(made) + 1, config, linked.name if linked else None, keeps))
        before[name] = made[-1]
    if not made:
        raise ValueError(f"stages must hold a table, got null for {', '.join(stages)}.")
    return made


def written_out(cfg: DictConfig) -> str:
    """The config of a training as yaml, in which each stage holds all of its values.

    ``stages_of`` makes the same stages of it, though nothing in it refers to anything else.
    """
    whole = OmegaConf.to_container(cfg, resolve=True)
    assert isinstance(whole, dict)
    for stage in stages_of(cfg) if cfg.get("stages") else ():
        values = OmegaConf.to_container(stage.config, resolve=True)
        assert isinstance(values, dict)
        if stage.begins_with:
            values["warm_start"] = _LINK + stage.begins_with
        whole["stages"][stage.name] = {k: v for k, v in values.items() if k not in OF_THE_RUN}
    return OmegaConf.to_yaml(OmegaConf.create(whole))


def check_stages(cfg: DictConfig, ranks: Ranks = ALONE) -> None:
    """Refuses a training one of whose stages cannot be, before the first begins.

    Every stage is set up and tried once, from what the ones before it are without training.

    Raises:
        ValueError: naming the stage and the key.
    """
    with TemporaryDirectory() as folder:
        (Path(folder) / "checkpoints").mkdir()
        linked_file = re.compile(re.escape(folder) + r"/checkpoints/(\w+)\.pt")
        for stage in stages_of(cfg) if cfg.get("stages") else ():
            assert stage.name is not None
            try:
                try_one_step(stage.config.env)
                learner = begin_stage(stage, Path(folder), ranks)
            except SPOKEN as error:
                reason = linked_file.sub(r"stage \1", in_one_line(error))
                raise ValueError(at(f"stages.{stage.name}", reason)) from error
            checkpoint.save(checkpoint_of_stage(Path(folder), stage.name), learner.state_dict())


def begin_stage(
    stage: Stage, folder: Path, ranks: Ranks = ALONE, *, goes_on: bool = False
) -> Learner:
    """The learner of a stage, with the weights that it begins with, see ``Learner.beginning``.

    Args:
        stage: of a training in ``folder``, where the stages before it are finished.
        folder: of the run.
        ranks: the processes that share it.
        goes_on: whether a checkpoint gives it other weights in any case. What it began with may
            then be gone.
    """
    config = OmegaConf.create(_filled(OmegaConf.to_container(stage.config), folder))
    learner = Learner(config, ranks)
    try:
        if stage.begins_with is not None:
            path = checkpoint_of_stage(folder, stage.begins_with)
            warm_start(learner, path, keep_deviation=stage.keeps_deviation)
        elif config.warm_start is not None:
            warm_start(learner, config.warm_start)
    except (ValueError, OSError):
        if not goes_on:
            raise
    learner.begins_here()
    return learner


def stage_reached(cfg: DictConfig, state: Mapping[str, Any] | None) -> Stage:
    """The stage of a training at which a checkpoint was written; without one the first."""
    number = state["run"].get("stage", 0) if state else 0
    return stages_of(cfg)[max(0, number - 1)]


def check_lengths(config: str, overrides: Sequence[str], reached: int = 0) -> None:
    """Refuses a length that no stage to come would have.

    Args:
        config: of the training as it is without them, yaml.
        overrides: from the shell.
        reached: number of the stage at hand.

    Raises:
        ValueError: naming the key and those that can be given.
    """
    given: Mapping[str, Any] = DictConfig(OmegaConf.create(config)).get("stages") or {}
    stages = {name: stage for name, stage in given.items() if stage is not None}
    open_ones = list(stages)[max(0, reached - 1) :]
    can = ", ".join(f"+stages.{name}.total_frames" for name in open_ones)
    for key in (override.partition("=")[0].lstrip("+") for override in overrides):
        first, *rest = key.split(".")
        if (
            first == "stages"
            and len(rest) == 2
            and rest[0] not in (open_ones if reached else stages)
        ):
            raise ValueError(f"{key} must be that of a stage which is not over: {can or 'none'}.")
        own = [isinstance(stage, Mapping) and "total_frames" in stage for stage in stages.values()]
        if key == "total_frames" and own and all(own):
            raise ValueError(f"total_frames must be given for a stage, each has its own: {can}.")


def checkpoint_of_stage(folder: Path, name: str) -> Path:
    """Where what a stage came to is kept."""
    return folder / "checkpoints" / f"{name}.pt"


def _changed(value: Any, changes: Any) -> Any:
    """A config with some of its values replaced; another class takes none of the old arguments."""
    if not (isinstance(value, Mapping) and isinstance(changes, Mapping)):
        return changes
    if changes.get("_target_", value.get("_target_")) != value.get("_target_"):
        return changes
    return {**value, **{key: _changed(value.get(key), new) for key, new in changes.items()}}


def _check(name: Any, changes: Any) -> None:
    """Refuses a stage whose name or keys it cannot have."""
    if not (isinstance(name, str) and name.isidentifier()) or name in _TAKEN:
        raise ValueError(
            f"stages must have names of letters, digits and _, not {' or '.join(_TAKEN)}, "
            f"got {name!r}."
        )
    if changes is None:
        return
    if not isinstance(changes, Mapping):
        raise ValueError(
            f"stages.{name} must be a table of what it changes, or null, got {changes}."
        )
    own = [key for key in TrainKeys.__annotations__ if key not in OF_THE_RUN]
    for key in changes:
        if key not in own:
            raise ValueError(f"stages.{name} must hold {', '.join(own)} alone, got {key}.")


def _filled(value: Any, folder: Path) -> Any:
    """A config with files in the folder of the run for the stages that it names."""
    if isinstance(value, Mapping):
        return {key: _filled(each, folder) for key, each in value.items()}
    if isinstance(value, list):
        return [_filled(each, folder) for each in value]
    if _is_link(value):
        return str(checkpoint_of_stage(folder, value.removeprefix(_LINK)))
    return value


def _is_link(value: Any) -> bool:
    return isinstance(value, str) and value.startswith(_LINK)


def _check_links(value: Any, before: Mapping[str, Any], place: str) -> None:
    """Refuses values that name a stage which is not there, or not over."""
    if isinstance(value, Mapping | list):
        entries = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, each in entries:
            _check_links(each, before, f"{place}.{key}")
    elif _is_link(value) and value.removeprefix(_LINK) not in before:
        there = f"a stage before it, {', '.join(before)}" if before else "no stage, it is the first"
        raise ValueError(f"{place} must name {there}, got {value}.")
