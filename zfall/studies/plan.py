"""The plan of a study: what is trained, what it is tested with, and in which worlds."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from zfall.configs import compose_config
from zfall.envs.tables import INTERFACE, env_digest
from zfall.errors import in_one_line
from zfall.evaluation.definitions import Battery, load_battery
from zfall.evaluation.kinds import kind_of
from zfall.evaluation.metrics import MEASURES
from zfall.fingerprints import digest
from zfall.studies.store import training_digest
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
        name: tells its result from all others, whatever study they belong to.
    """

    title: str
    env_cfg: DictConfig | None
    name: str


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
    runs = [
        _run(study, battery, row, seed)
        for row in study.rows
        for seed in study.row_seeds.get(row, study.seeds)
    ]
    _check_differ(runs)
    return runs


def _run(study: "Study", battery: Battery, row: str, seed: int) -> Run:
    """The run of a row with one seed, checked."""
    with of(f"study.rows.{row}"):
        cfg = training([*study.base, *study.rows[row]], seed, study)
        wanted: dict[str, Any] = {
            "training": training_digest(cfg),
            "measures": MEASURES,
            "battery": asdict(battery),
            "training_size": study.training_size,
        }
    if row not in study.tested_with:
        return Run(str(row), seed, cfg, None, (), _tests(study, wanted))
    table = study.tested_with[row]
    with of(f"study.tested_with.{row}"):
        partner = build_tested_with(table)
        others = tuple(training(overrides, seed, study) for overrides in partner.trainings)
        trained = [training_digest(other) for other in others]
        wanted["tested_with"] = [table["_target_"], partner.fingerprint(), trained]
    tests = _tests(study, wanted)
    for test in tests:
        with of(f"study.tests.{test.title}" if test.title else f"study.tested_with.{row}"):
            partner.check(cfg, others, in_test(test, cfg.env))
    return Run(str(row), seed, cfg, partner, others, tests)


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
    text = str(size) if size is None else f"{float(size):g}"
    if text not in (sizes := [f"{impulse:g}" for impulse in battery.impulses]):
        raise ValueError(f"it must be one of {', '.join(sizes)}, got {text}.")
    return text


def training(overrides: Sequence[str], seed: int, study: "Study") -> DictConfig:
    """The config of a training of a study, whose overrides may replace its ``total_frames``."""
    own = [f"seed={seed}", f"total_frames={study.total_frames}", "showcase=null"]
    cfg = compose_config([*own, *overrides])
    check_config(cfg)
    if cfg.seed != seed:
        raise ValueError(f"seed must be left to seeds and row_seeds of the study, got {cfg.seed}.")
    if cfg.resume is not None:
        raise ValueError(f"resume must be null, a study goes on by itself, got {cfg.resume}.")
    return cfg


@contextmanager
def of(key: str) -> Iterator[None]:
    """Says of which key of the study it is that something is wrong."""
    try:
        yield
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        raise ValueError(f"{key}: {in_one_line(error)}") from error
    except (AttributeError, TypeError) as error:
        raise ValueError(f"{key}: a value may be of another kind than it takes: {error}") from error


def _tests(study: "Study", wanted: dict[str, Any]) -> tuple[Test, ...]:
    """The tests of a run, whose results depend on what is ``wanted`` and the test's world."""
    tests = []
    for title, overrides in (study.tests or {"": None}).items():
        env_cfg, more = None, {}
        if overrides is not None:
            with of(f"study.tests.{title}"):
                test_cfg = compose_config([*study.base, *overrides])
                check_config(test_cfg)
                env_cfg = test_cfg.env
                more = {"test": env_digest(env_cfg)}
        tests.append(Test(str(title), env_cfg, digest(wanted | more)))
    return tuple(tests)


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
