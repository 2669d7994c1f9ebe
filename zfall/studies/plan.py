"""The plan of a study: what is trained, beside what it acts, and in which worlds it is tested."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from zfall import checkpoint
from zfall.configs import compose_config
from zfall.envs.tables import INTERFACE, check_same_interface, env_digest
from zfall.errors import check_number
from zfall.evaluation.definitions import Battery, load_battery
from zfall.evaluation.metrics import MEASURES
from zfall.falling.files import MOVEMENTS
from zfall.fingerprints import digest, file_digest
from zfall.policies.load import checkpoint_of
from zfall.training.config import check_config

NEEDED = ("name", "base", "rows", "seeds", "total_frames", "battery")
STUDY = {*NEEDED, "row_seeds", "training_size", "tests", "beside"}
SCRIPT = "script"  # in the place of a policy that kneels


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
        beside: ``recover`` or ``kneel``, and the policy of that mode, which the mode machine
            switches with: the name of one that ships, ``script``, or the config of its training.
        tests: where it is tested.
    """

    row: str
    seed: int
    cfg: DictConfig
    beside: tuple[str, str | DictConfig] | None
    tests: tuple[Test, ...]

    @property
    def trainings(self) -> list[DictConfig]:
        """All that is to be trained."""
        other = self.beside[1] if self.beside else None
        return [self.cfg, *([other] if isinstance(other, DictConfig) else [])]


def plan(study: DictConfig) -> list[Run]:
    """All runs of a study; every config is composed now, so that a bad one fails before any runs.

    Raises:
        ValueError: if a key is missing, two rows, seeds or tests are the same, something is said of
            a row that is not there, or a test cannot tell what the table shows.
    """
    missing = [key for key in NEEDED if OmegaConf.select(study, key) is None]
    if missing:
        raise ValueError(f"study.{missing[0]} is missing: a study has {', '.join(NEEDED)}.")
    _check_kinds(study)
    with of("study.battery"):
        battery = battery_of(study)
    size = OmegaConf.select(study, "training_size")
    with of("study.training_size"):
        size = size if size is None else f"{float(size):g}"
    if not battery.forces and size not in (sizes := [f"{i:g}" for i in battery.impulses]):
        raise ValueError(f"study.training_size must be one of {', '.join(sizes)}, got {size}.")
    for key in ("beside", "row_seeds"):
        unknown = set(OmegaConf.select(study, key) or {}) - set(study.rows)
        if unknown:
            raise ValueError(
                f"study.{key} must name rows ({', '.join(map(str, study.rows))}), "
                f"got {sorted(map(str, unknown))[0]}."
            )
    runs = []
    for row, overrides in study.rows.items():
        for seed in (OmegaConf.select(study, "row_seeds") or {}).get(row, study.seeds):
            with of(f"study.rows.{row}"):
                cfg = training([*study.base, *overrides], seed, study)
                trained = training_digest(cfg)
            beside = _beside(study, row, seed)
            tests = _tests(study, trained, beside)
            if beside is not None:
                _check_switched(str(row), cfg, beside, tests)
            runs.append(Run(str(row), int(seed), cfg, beside, tests))
    same: dict[str, str] = {}
    for run in runs:
        for test in run.tests:
            what = shown(run, test)
            if test.name in same:
                raise ValueError(f"rows must differ, {what} and {same[test.name]} are the same.")
            same[test.name] = what
    return runs


def battery_of(study: DictConfig) -> Battery:
    """The battery of a study, with its options."""
    options: dict[str, Any] = dict(OmegaConf.to_container(study.battery))  # type: ignore[arg-type]
    return load_battery(options.pop("name"), **options)


def training(overrides: Sequence[str], seed: int, study: DictConfig) -> DictConfig:
    """The config of a training of a study; a row may have a ``total_frames`` of its own."""
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
        raise ValueError(f"{key}: {error}") from error
    except (AttributeError, TypeError) as error:
        raise ValueError(f"{key}: a value may be of another kind than it takes: {error}") from error


def _check_kinds(study: DictConfig) -> None:
    """Refuses a study without runs, and values of another kind than it has."""
    for key in ("rows", "tests", "beside", "row_seeds"):
        if (table := study.get(key)) is not None and not isinstance(table, DictConfig):
            raise ValueError(f"study.{key} must be a table, NAME: VALUE, got {table}.")
    if not study.rows:
        raise ValueError(f"study.rows must be at least one NAME: [OVERRIDES], got {study.rows}.")
    if not isinstance(study.battery, DictConfig) or "name" not in study.battery:
        raise ValueError(f"study.battery must be {{name: ..., ...}}, got {study.battery}.")
    tests = {key: each for key, each in _by_name(study, "tests").items() if each is not None}
    lists = {"base": study.base, **_by_name(study, "rows"), **tests}
    seeds = {"seeds": study.seeds, **_by_name(study, "row_seeds")}
    for key, values in (lists | seeds).items():
        if not isinstance(values, ListConfig):
            raise ValueError(f"study.{key} must be a list, got {values}.")
    for key, values in lists.items():
        if not all(isinstance(override, str) for override in values):
            raise ValueError(f"study.{key} must be a list of overrides, KEY=VALUE, got {values}.")
    for key, values in seeds.items():
        if not values or any(type(seed) is not int or seed < 0 for seed in values):
            raise ValueError(f"study.{key} must be whole numbers from 0 on, got {values}.")
    frames = study.total_frames
    check_number(frames, "study.total_frames", lambda x: 0 < x < math.inf, "be a positive number")


def _by_name(study: DictConfig, key: str) -> dict[str, Any]:
    return {f"{key}.{name!s}": each for name, each in (study.get(key) or {}).items()}


def _beside(study: DictConfig, row: Any, seed: int) -> tuple[str, str | DictConfig] | None:
    given = (OmegaConf.select(study, "beside") or {}).get(row)
    if given is None:
        return None
    parts = list(given.items()) if isinstance(given, DictConfig) else []
    role, other = parts[0] if len(parts) == 1 else ("", "")
    if not other or not (role == "kneel" or (role == "recover" and other != SCRIPT)):
        raise ValueError(
            f"study.beside must give {row} one policy, recover: NAME or kneel: NAME, a list of "
            f"overrides in place of NAME, or kneel: script; got {given}."
        )
    with of(f"study.beside.{row}"):
        if isinstance(other, str):
            if other != SCRIPT:
                checkpoint_of(other)
            return str(role), other
        if not isinstance(other, ListConfig):
            raise ValueError(f"it must be a name or a list of overrides, got {other}.")
        cfg = training(list(other), seed, study)
        training_digest(cfg)
        return str(role), cfg


def _check_switched(
    row: str, cfg: DictConfig, beside: tuple[str, str | DictConfig], tests: Sequence[Test]
) -> None:
    """Refuses a policy beside another where nothing switches, or that sees or does other things."""
    for test in tests:
        mode = OmegaConf.select(in_test(test, cfg.env), "transforms.mode")
        if mode is None or mode.initial != "recover":
            raise ValueError(
                f"study.tests must switch what stands beside {row}: a world with a mode machine "
                f"that begins in recover, got {test.title or 'its own'}."
            )
    role, other = beside
    if isinstance(other, str):
        if other == SCRIPT:
            return
        other = OmegaConf.create(checkpoint.load(checkpoint_of(other))["config"])
    check_same_interface({row: cfg, role: other})


def _tests(
    study: DictConfig, trained: str, beside: tuple[str, str | DictConfig] | None
) -> tuple[Test, ...]:
    wanted: dict[str, Any] = {
        "training": trained,
        "measures": MEASURES,
        "battery": asdict(battery_of(study)),
        "training_size": OmegaConf.select(study, "training_size"),
    }
    if beside is not None:
        role, other = beside
        if isinstance(other, DictConfig):
            wanted["beside"] = [role, training_digest(other)]
        else:
            path = MOVEMENTS if other == SCRIPT else checkpoint_of(other)
            wanted["beside"] = [role, other, file_digest(path)]
    tests = []
    for title, overrides in (OmegaConf.select(study, "tests") or {"": None}).items():
        env_cfg, more = None, {}
        if overrides is not None:
            with of(f"study.tests.{title}"):
                test_cfg = compose_config([*study.base, *overrides])
                check_config(test_cfg)
                env_cfg = test_cfg.env
                more = {"test": env_digest(env_cfg)}
        tests.append(Test(str(title), env_cfg, digest(wanted | more)))
    return tuple(tests)


def training_digest(cfg: DictConfig) -> str:
    """Tells a training from all others."""
    config = cfg.copy()
    OmegaConf.set_struct(config, False)
    config.pop("groups", None)  # of another number random numbers differ, but not what is trained
    wanted = {"config": OmegaConf.to_yaml(config, resolve=True), "env": env_digest(cfg.env)}
    if cfg.warm_start is not None:
        wanted["warm_start"] = file_digest(checkpoint_of(cfg.warm_start, key="warm_start"))
    losses = (cfg.get("auxiliary_losses") or {}).items()
    teachers = {name: loss.teacher for name, loss in losses if "teacher" in loss}
    if teachers:
        paths = [
            checkpoint_of(str(run), key=f"auxiliary_losses.{name}.teacher")
            for name, run in teachers.items()
        ]
        wanted["teachers"] = " ".join(map(file_digest, paths))
    return digest(wanted)


def run_folder(runs: Path, cfg: DictConfig) -> Path:
    """Where a training of this config lies, whatever study or row it is for."""
    return runs / training_digest(cfg)


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
