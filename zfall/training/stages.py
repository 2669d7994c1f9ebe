"""A training in several stages: the config of each, and where each begins."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory
from typing import Any

from omegaconf import DictConfig, OmegaConf

from zfall import checkpoint
from zfall.errors import SPOKEN, at, in_one_line
from zfall.training.keys import TrainKeys
from zfall.training.learner import Learner
from zfall.training.links import LINK, check_links, filled, is_link
from zfall.training.makers import file_of, maker_of
from zfall.training.ranks import ALONE, Ranks
from zfall.training.trial_step import try_one_step
from zfall.training.warm_start import warm_start

# Keys that are the run's.
OF_THE_RUN = (
    *("stages", "experiment", "resume", "trust", "name", "logger", "showcase"),
    *("recover",),
    "checkpoint_every",
)
_MADE = re.compile(r"/(?:checkpoints|made)/(\w+)\.\w+")  # what a stage came to, in a folder
_TAKEN = ("last", "best")  # checkpoints that every run has


@dataclass(frozen=True)
class Stage:
    """A part of a training, which trains a policy or makes a file in place of it.

    Attributes:
        name: of the stage; None of a training that has none.
        number: from 1 on; 0 of a training that has none.
        config: of a training by itself.
        make: what it makes, plain containers, see ``zfall.training.makers``; None: it trains.
        files: what the stages before it come to, by name, within the folder of the run.
        begins_with: the stage before it with whose weights it begins, if any.
        keeps_deviation: whether it explores as much as that one did at its end: if both have the
            same ``actor.std``.
    """

    name: str | None
    number: int
    config: DictConfig
    begins_with: str | None = None
    keeps_deviation: bool = True
    make: Mapping[str, Any] | None = None
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def file(self) -> str:
        """What it comes to, within the folder of the run."""
        assert self.name is not None
        return file_of(self.make, self.name) if self.make else f"checkpoints/{self.name}.pt"


def stages_of(cfg: DictConfig) -> list[Stage]:
    """The stages of a training in their order, or the training itself as the only one.

    Each is the config with the stage's values in place of its own. A stage begins with the weights
    of the last one before it that trained, or as its ``warm_start`` says: with those of another
    one before it, ``stage:NAME``, of a run or policy, or with none (``null``). Wherever else a file
    or policy is named, ``stage:NAME`` is what a stage before it came to. A stage that has ``make``
    makes that in place of training. A stage that is null is left out.

    Raises:
        ValueError: on a stage that is neither a table nor null, a name that it cannot have, or a
            key that is that of the whole run.
    """
    if not cfg.get("stages"):
        return [Stage(None, 0, cfg)]
    base = OmegaConf.to_container(cfg, resolve=False)
    assert isinstance(base, dict)
    stages = base.pop("stages")
    before: dict[str, Stage] = {}
    for name, changes in stages.items():
        _check(name, changes)
        if changes is None:
            continue
        of = _made if "make" in changes else _trained
        before[name] = of(name, {**base, "stages": {}}, changes, before)
    if not before:
        raise ValueError(f"stages must hold a table, got null for {', '.join(stages)}.")
    return list(before.values())


def _files(before: Mapping[str, Stage]) -> dict[str, str]:
    return {name: stage.file for name, stage in before.items()}


def _made(name: str, base: Any, changes: Any, before: Mapping[str, Stage]) -> Stage:
    """A stage that makes something."""
    config = OmegaConf.create({**base, "make": changes["make"]})  # which may refer to the others
    given = config.make
    make: Any = OmegaConf.to_container(given, resolve=True) if OmegaConf.is_config(given) else given
    check_links(make, before, f"stages.{name}.make")
    file_of(make, name)
    return Stage(name, len(before) + 1, config, make=make, files=_files(before))


def _trained(name: str, base: Any, changes: Any, before: Mapping[str, Stage]) -> Stage:
    """A stage that trains."""
    merged = _changed(base, changes)
    last = next((stage.name for stage in [*before.values()][::-1] if stage.make is None), None)
    start = changes.get("warm_start", f"{LINK}{last}" if last else base["warm_start"])
    check_links({**merged, "warm_start": start}, before, f"stages.{name}")
    linked = before[start.removeprefix(LINK)] if is_link(start) else None
    if linked and not linked.file.startswith("checkpoints/"):
        raise ValueError(
            f"stages.{name}.warm_start must name a stage that comes to a policy, got {start}."
        )
    merged["warm_start"] = None if linked else start
    config = OmegaConf.create(merged)
    keeps = linked is not None and linked.config.actor.get("std") == config.actor.get("std")
    begins_with = linked.name if linked else None
    return Stage(name, len(before) + 1, config, begins_with, keeps, files=_files(before))


def written_out(cfg: DictConfig) -> str:
    """The config of a training as yaml, in which each stage holds all of its values.

    ``stages_of`` makes the same stages of it, though nothing in it refers to anything else.
    """
    whole = OmegaConf.to_container(cfg, resolve=True)
    assert isinstance(whole, dict)
    for stage in stages_of(cfg) if cfg.get("stages") else ():
        if stage.make is not None:
            continue
        values = OmegaConf.to_container(stage.config, resolve=True)
        assert isinstance(values, dict)
        if stage.begins_with:
            values["warm_start"] = LINK + stage.begins_with
        whole["stages"][stage.name] = {k: v for k, v in values.items() if k not in OF_THE_RUN}
    return OmegaConf.to_yaml(OmegaConf.create(whole))


def check_stages(cfg: DictConfig, ranks: Ranks = ALONE) -> None:
    """Refuses a training one of whose stages cannot be, before the first begins.

    Every stage is set up and tried once, from what the ones before it are without training.

    Raises:
        ValueError: naming the stage and the key.
    """
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for part in ("checkpoints", "made"):
            (folder / part).mkdir()
        for stage in stages_of(cfg) if cfg.get("stages") else ():
            assert stage.name is not None
            path = folder / stage.file
            try:
                if stage.make is not None:
                    maker_of(stage.make, stage.name, folder, stage.files).stand_in(path)
                    continue
                try_one_step(with_files(stage, folder).env)
                learner = begin_stage(stage, folder, ranks)
            except SPOKEN as error:
                reason = _MADE.sub(r"stage \1", in_one_line(error).replace(temporary, ""))
                place = f"stages.{stage.name}"
                raise ValueError(
                    reason if reason.startswith(place) else at(place, reason)
                ) from error
            checkpoint.save(path, learner.state_dict())


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
    config = with_files(stage, folder)
    learner = Learner(config, ranks)
    try:
        if stage.begins_with is not None:
            path = folder / stage.files[stage.begins_with]
            warm_start(learner, path, keep_deviation=stage.keeps_deviation)
        elif config.warm_start is not None:
            warm_start(learner, config.warm_start)
    except (ValueError, OSError):
        if not goes_on:
            raise
    learner.begins_here()
    return learner


def with_files(stage: Stage, folder: Path) -> DictConfig:
    """The config of a stage, with what the stages that it names came to."""
    return OmegaConf.create(filled(OmegaConf.to_container(stage.config), folder, stage.files))


def remove_made(stages: Sequence[Stage], folder: Path) -> None:
    """Removes what stages made in place of training."""
    for stage in stages:
        if stage.make is not None:
            (folder / stage.file).unlink(missing_ok=True)
            rmtree(folder / "made" / str(stage.name), ignore_errors=True)


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
    trained = {name: stage for name, stage in stages.items() if not _makes(stage)}
    open_ones = [name for name in list(stages)[max(0, reached - 1) :] if name in trained]
    can = ", ".join(f"+stages.{name}.total_frames" for name in open_ones)
    for key in (override.partition("=")[0].lstrip("+") for override in overrides):
        first, *rest = key.split(".")
        if (
            first == "stages"
            and len(rest) == 2
            and rest[0] not in (open_ones if reached else trained)
        ):
            raise ValueError(f"{key} must be that of a stage which is not over: {can or 'none'}.")
        own = [isinstance(stage, Mapping) and "total_frames" in stage for stage in trained.values()]
        if key == "total_frames" and own and all(own):
            raise ValueError(f"total_frames must be given for a stage, each has its own: {can}.")


def _makes(stage: Any) -> bool:
    return isinstance(stage, Mapping) and "make" in stage


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
    if _makes(changes) and len(changes) > 1:
        more = next(key for key in changes if key != "make")
        raise ValueError(f"stages.{name} must hold nothing else where it holds make, got {more}.")
    if _makes(changes):
        return
    own = [key for key in TrainKeys.__annotations__ if key not in OF_THE_RUN]
    for key in changes:
        if key not in own:
            raise ValueError(f"stages.{name} must hold {', '.join(own)} alone, got {key}.")
