"""The plan of a study: what is trained, what it is tested with, and in which worlds."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from zfall.configs import compose_config
from zfall.envs.tables import INTERFACE
from zfall.errors import in_one_line
from zfall.evaluation.definitions import Battery, load_battery
from zfall.evaluation.kinds import kind_of
from zfall.evaluation.metrics import MEASURES
from zfall.fingerprints import digest
from zfall.meaning import strict
from zfall.studies.inputs import Inputs, meaning_of, training_inputs, world_inputs
from zfall.studies.tested_with import TestedWith, build_tested_with
from zfall.training.checks import check_config

if TYPE_CHECKING:
    from zfall.studies.study import Study


@dataclass(frozen=True)
class Test:
    """A world in which the policies of a study are tested.

    Args:
        title: of the table; empty if each is tested in its own world.
        env_cfg: config of the env, but for what the policy sees and does; ``None``: its own.
        inputs: all that its result follows from.
    """

    title: str
    env_cfg: DictConfig | None
    inputs: Inputs

    @cached_property
    def meaning(self) -> dict[str, str]:
        """What tells its result from all others."""
        return meaning_of(self.inputs)

    @cached_property
    def name(self) -> str:
        """A digest of ``meaning``."""
        return digest(self.meaning)


class _World(NamedTuple):
    title: str
    env_cfg: DictConfig | None
    inputs: Inputs


@dataclass(frozen=True)
class Run:
    """One row with one seed.

    Args:
        row: its name.
        seed: of the training.
        cfg: of ``recipes.train``, as it is run.
        tested_with: what its policy is tested with, if not alone.
        others: configs of the trainings that this needs.
        tests: where it is tested.
    """

    row: str
    seed: int
    cfg: DictConfig
    tested_with: TestedWith | None
    others: tuple[DictConfig, ...]
    tests: tuple[Test, ...]

    @property
    def trainings(self) -> list[DictConfig]:
        """All that is to be trained."""
        return [self.cfg, *self.others]


def plan(study: "Study") -> list[Run]:
    """All runs of a study; every config is composed now, so that a bad one fails before any runs.

    Raises:
        ValueError: if two rows, seeds or tests are the same, or a test cannot be made or cannot
            give what the table shows.
    """
    with of("study.battery"):
        battery = battery_of(study)
    with of("study.training_size"):
        training_size_of(study, battery)
    worlds = _worlds(study)
    runs = [run for row in study.rows for run in _runs(study, battery, worlds, row)]
    _check_differ(runs)
    return runs


def _runs(study: "Study", battery: Battery, worlds: Sequence[_World], row: str) -> Iterator[Run]:
    """The runs of a row, one a seed, checked."""
    seeds = study.row_seeds.get(row, study.seeds)
    with of(f"study.rows.{row}"):
        configs = trainings([*study.base, *study.rows[row]], seeds, study)
        known = {
            "battery": strict(asdict(battery)),
            "measures": MEASURES,
            "training_size": training_size_of(study, battery),
        }
        inputs = [known | {"training": training_inputs(cfg)} for cfg in configs]
    partner: TestedWith | None = None
    others: list[tuple[DictConfig, ...]] = [()] * len(seeds)
    if row in study.tested_with:
        table = study.tested_with[row]
        with of(f"study.tested_with.{row}"):
            partner = build_tested_with(table)
            theirs = [trainings(overrides, seeds, study) for overrides in partner.trainings]
            others = list(zip(*theirs, strict=True)) or others
            known = {"tested_with": [table["_target_"], partner.fingerprint()]}
            for each, those in zip(inputs, others, strict=True):
                each |= known | {"others": [training_inputs(other) for other in those]}
    for seed, cfg, those, each in zip(seeds, configs, others, inputs, strict=True):
        tests = tuple(Test(title, env_cfg, {**each, **more}) for title, env_cfg, more in worlds)
        run = Run(str(row), seed, cfg, partner, those, tests)
        _check_partner(run)
        yield run


def _check_partner(run: Run) -> None:
    """Refuses what a policy is tested with if it would fail in a test."""
    partner = run.tested_with
    if partner is None:
        return
    for test in run.tests:
        with of(f"study.tests.{test.title}" if test.title else f"study.tested_with.{run.row}"):
            partner.check(run.cfg, run.others, in_test(test, run.cfg.env))


def _worlds(study: "Study") -> list[_World]:
    """The worlds of the tests of a study, checked."""
    worlds = []
    for title, overrides in (study.tests or {"": None}).items():
        if overrides is None:
            worlds.append(_World(str(title), None, {}))
            continue
        with of(f"study.tests.{title}"):
            test_cfg = compose_config([*study.base, *overrides])
            check_config(test_cfg)
            worlds.append(_World(str(title), test_cfg.env, {"world": world_inputs(test_cfg.env)}))
    return worlds


def battery_of(study: "Study") -> Battery:
    """The battery of a study, with its options."""
    options = dict(study.battery)
    return load_battery(options.pop("name"), **options)


def training_size_of(study: "Study", battery: Battery) -> str:
    """The impulse whose success the table shows, as a key of ``success``; empty if it shows none.

    Raises:
        ValueError: if it is none of the battery's.
    """
    if not kind_of(battery).needs_training_size:
        return ""
    size = study.training_size
    try:
        text = str(size) if size is None else f"{float(size):g}"
    except (TypeError, ValueError):
        text = str(size)
    if text not in (sizes := [f"{impulse:g}" for impulse in battery.impulses]):
        raise ValueError(f"it must be one of {', '.join(sizes)}, got {text}.")
    return text


def trainings(overrides: Sequence[str], seeds: Sequence[int], study: "Study") -> list[DictConfig]:
    """The configs of trainings of a study, whose overrides may replace its ``total_frames``."""
    own = [f"seed={seeds[0]}", f"total_frames={study.total_frames}", "showcase=null"]
    cfg = compose_config([*own, *overrides])
    check_config(cfg)
    if cfg.seed != seeds[0]:
        raise ValueError(f"seed must be left to seeds and row_seeds of the study, got {cfg.seed}.")
    if cfg.resume is not None:
        raise ValueError(f"resume must be null, a study goes on by itself, got {cfg.resume}.")
    configs = [cfg, *(cfg.copy() for _ in seeds[1:])]
    for each, seed in zip(configs, seeds, strict=True):
        each.seed = seed
    return configs


@contextmanager
def of(key: str) -> Iterator[None]:
    """Says of which key of the study it is that something is wrong."""
    try:
        yield
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        raise ValueError(f"{key}: {in_one_line(error)}") from error
    except (AttributeError, TypeError) as error:
        raise ValueError(f"{key}: a value may be of another kind than it takes: {error}") from error


def _check_differ(runs: Sequence[Run]) -> None:
    """Refuses two tests with the same result."""
    same: dict[str, str] = {}
    for run in runs:
        for test in run.tests:
            what = shown(run, test)
            if test.name in same:
                raise ValueError(f"rows must differ, {what} and {same[test.name]} are the same.")
            same[test.name] = what


def in_test(test: Test, own_cfg: DictConfig) -> DictConfig:
    """The world of a test, in which a policy sees, does and decides as in its own."""
    if test.env_cfg is None:
        return own_cfg
    env_cfg = test.env_cfg.copy()
    env_cfg.base_env.control_dt = own_cfg.base_env.control_dt
    for name in INTERFACE:
        env_cfg.transforms[name] = own_cfg.transforms[name]
    return env_cfg


def shown(run: Run, test: Test) -> str:
    """What to call a test in a message."""
    return f"{run.row} (seed {run.seed}{', ' * bool(test.title)}{test.title})"
