"""What a file may name to be built: classes and functions that can do no harm.

The config inside a checkpoint names classes and functions, and whoever builds it runs them. A file
may come from a stranger, so all that it names is checked against ``ALLOWED`` before anything is
built. ``trusting`` adds modules of one's own.
"""

import inspect
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from zfall.configs import nodes_of
from zfall.errors import object_at
from zfall.moved import with_new_paths

_OPTIMIZERS = ("Adadelta", "Adafactor", "Adagrad", "Adam", "AdamW", "Adamax", "ASGD", "LBFGS",
               "Muon", "NAdam", "RAdam", "RMSprop", "Rprop", "SGD")  # fmt: skip
_SCHEDULERS = ("ConstantLR", "CosineAnnealingLR", "CosineAnnealingWarmRestarts", "CyclicLR",
               "ExponentialLR", "LambdaLR", "LinearLR", "MultiStepLR", "MultiplicativeLR",
               "OneCycleLR", "PolynomialLR", "ReduceLROnPlateau", "StepLR")  # fmt: skip
_TRANSFORMS = ("CatFrames", "DoubleToFloat", "InitTracker", "RewardClipping", "RewardScaling",
               "RewardSum", "StepCounter")  # fmt: skip

# Packages and modules: what is defined in them may be named. All else: this one class or function.
# What it reads is data. None of it writes, but for the makers of stages: into the run folder alone.
ALLOWED = (
    "zfall.envs.humanoid.HumanoidEnv",
    "zfall.envs.make.make_env",
    "zfall.envs.terms",
    "zfall.envs.transforms",
    "zfall.falling.fall_network.load_fall_network",
    "zfall.falling.falling_start",
    "zfall.falling.kneel_reference",
    "zfall.falling.making.LyingStates",
    "zfall.falling.making.RecordedFalls",
    "zfall.falling.making.SearchedCatches",
    "zfall.falling.making.SearchedRises",
    "zfall.falling.making.SwitchedPolicy",
    "zfall.falling.making.TrainedTrigger",
    "zfall.falling.mirrored_falls",
    "zfall.falling.modes",
    "zfall.falling.rise_reference",
    "zfall.falling.switched.still_actor",
    "zfall.falling.switched.switched_actor",
    "zfall.falling.terms",
    "zfall.losses",
    "zfall.modules",
    "zfall.robots",
    "zfall.training.optimizers.KLProportionalLR",
    "zfall.training.optimizers.MuonAndAdam",
    "zfall.training.shifted_pose.ShiftedPose",
    "torchrl.objectives.KLAdaptiveLR",
    *(f"torch.optim.{name}" for name in _OPTIMIZERS),
    *(f"torch.optim.lr_scheduler.{name}" for name in _SCHEDULERS),
    *(f"torchrl.envs.{name}" for name in _TRANSFORMS),
)
# These write: as entries of ``logger`` alone, into the run folder alone.
LOGGERS = ("torchrl.record.CSVLogger", "torchrl.record.TensorboardLogger")

_MOST_TEXT, _MOST_EVENTS, _DEEPEST = 1_000_000, 100_000, 40  # of ours: 10_000, 1_000, 12
_PATH = re.compile(r"[A-Za-z]\w*(\.[A-Za-z]\w*)+", re.ASCII)
_MODULE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", re.ASCII)
# Of a key, a run or a file: as a part of a path it leads nowhere else.
_NAME = re.compile(r"(?!\.|.*\.\.)[^/\\\x00-\x1f\x7f]+")
_FILLED_NAME = re.compile(r"(?!\.|.*\.\.)(\{name\}|[^/\\{}\x00-\x1f\x7f])+")
_IN_RUN_FOLDER = re.compile(r"\{folder\}(/[\w-]+)*", re.ASCII)
_trusted: ContextVar[tuple[str, ...]] = ContextVar("trusted", default=())


@contextmanager
def trusting(modules: Sequence[str]) -> Iterator[None]:
    """Within it, files may name what these modules define, too: their code is run.

    Args:
        modules: dotted paths of modules, packages, or of single classes and functions.

    Raises:
        ValueError: on anything else.
    """
    if isinstance(modules, str) or not isinstance(modules, Sequence):
        raise ValueError(f"trust must be a list of modules, [{modules}], got {modules}.")
    for module in modules:
        if not (isinstance(module, str) and _MODULE.fullmatch(module)):
            raise ValueError(f"trust must hold dotted paths of modules, got {_shown(module)}.")
    before = _trusted.set((*_trusted.get(), *modules))
    try:
        yield
    finally:
        _trusted.reset(before)


def trusts(path: str) -> bool:
    """Whether ``trusting`` has a dotted path, or a module or package that it lies in."""
    return any(f"{path}.".startswith(f"{entry}.") for entry in _trusted.get())


def targets_of(config: DictConfig) -> list[str]:
    """All that a config names to be built; of one that the user composed it may be trusted."""
    plain = OmegaConf.to_container(config, resolve=True)
    return list(dict.fromkeys(str(node["_target_"]) for _, node in nodes_of(plain)))


def config_of_file(text: Any, path: Path) -> DictConfig:
    """The config inside a file, once nothing in it can do harm.

    It is plain: no interpolations, which could read the environment; no yaml tags and aliases; no
    keys that lead out of a folder when a file is named by them. Older paths are replaced by new
    ones.

    Args:
        text: yaml.
        path: of the file, for messages.

    Raises:
        ValueError: naming the file, the key, and what stands there.
    """
    text = with_new_paths(text) if isinstance(text, str) else text
    config = OmegaConf.create(_plain_yaml(text, f"{path}: its config"))
    _check(OmegaConf.to_container(config, resolve=False), "", path)
    if not _is_name(config.get("name") or "run"):
        raise ValueError(f"{path}: name must be a plain name, got {_shown(config['name'])}.")
    config.pop("trust", None)  # it is for the user to say
    return config


def texts_of_file(path: Path) -> list[str]:
    """A list of texts out of a yaml file, as they stand there, without interpolation.

    Raises:
        ValueError: if it is something else.
    """
    try:
        entries = _plain_yaml(path.read_text(), str(path), kind=list)
    except (UnicodeDecodeError, OSError) as error:
        raise ValueError(f"{path} must be a list of texts, cannot read it.") from error
    return [str(entry) for entry in entries]


def _plain_yaml(text: Any, what: str, kind: type = dict) -> Any:
    """Plain containers from a yaml of moderate size that has no tags and no aliases."""
    rule = f"{what} must be a yaml {'table' if kind is dict else 'list'} of plain values"
    if not isinstance(text, str):
        raise ValueError(f"{rule}, got {type(text).__name__}.")
    if len(text) > _MOST_TEXT:
        raise ValueError(f"{rule}, at most {_MOST_TEXT} characters long, got {len(text)}.")
    try:
        forbidden = _forbidden(text)
        value = None if forbidden else OmegaConf.create(text)
    except (yaml.YAMLError, OmegaConfBaseException, AssertionError, RecursionError) as error:
        reason = _shown(str(error).partition("\n")[0])
        raise ValueError(f"{rule}, cannot read it: {reason}.") from error
    if forbidden:
        raise ValueError(f"{rule}, got {forbidden}.")
    plain = OmegaConf.to_container(value, resolve=False)
    if not isinstance(plain, kind):
        raise ValueError(f"{rule}, got {type(plain).__name__}.")
    return plain


def _forbidden(text: str) -> str | None:
    """What of a yaml is not plain, or too much, before anything is made of it."""
    depth = 0
    for number, event in enumerate(yaml.parse(text, Loader=yaml.SafeLoader)):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST or number > _MOST_EVENTS:
            return f"more than {_DEEPEST} levels or {_MOST_EVENTS} parts"
        if anchor := getattr(event, "anchor", None):  # of an alias, too
            return f"the alias {_shown(anchor)}"
        if (tag := getattr(event, "tag", None)) is not None:
            return f"the tag {_shown(tag)}"
    return None


def _check(value: Any, place: str, path: Path) -> None:
    """Refuses a config of a file, and all within it, that is not plain or names too much."""
    if isinstance(value, Mapping):
        if "_target_" in value:
            _check_target(value, place, path)
        for key, entry in value.items():
            at = f"{place}.{key}" if place else str(key)
            if not _is_name(key):
                raise ValueError(f"{path}: {_shown(at)} must be a plain name, it is none.")
            _check(entry, at, path)
    elif isinstance(value, list):
        for number, entry in enumerate(value):
            _check(entry, f"{place}.{number}", path)
    elif isinstance(value, str) and "${" in value:
        raise ValueError(
            f"{path}: {place} must be plain, without interpolation, got {_shown(value)}."
        )


def _check_target(node: Mapping[str, Any], place: str, path: Path) -> None:
    target = node["_target_"]
    rule = f"{path}: {place}._target_ must name"
    if not (isinstance(target, str) and _PATH.fullmatch(target)):
        raise ValueError(f"{rule} a class or function, got {_shown(target)}.")
    own_logger = target in LOGGERS and target not in _trusted.get()
    if own_logger and re.fullmatch(r"logger\.\d+", place):
        _check_logger(node, place, path)
        return
    for entry in (*ALLOWED, *_trusted.get()):
        if not f"{target}.".startswith(f"{entry}."):  # it is not even imported
            continue
        found = object_at(target, f"{path}: {place}._target_")
        if callable(found) if target == entry else _is_defined_in(entry, found):
            return
    module = target.partition(".")[0]
    hint = ": no file may name that."
    if _is_own(module):
        hint = f"; trust=[{module}] if you trust its code."
    raise ValueError(f"{rule} what zfall or a trusted module defines, got {_shown(target)}{hint}")


def _is_defined_in(entry: str, found: Any) -> bool:
    """Whether it is a class or function that a module or package itself defines.

    What its modules import does not count: ``zfall.envs.terms.feet.torch.load``.
    """
    home = getattr(found, "__module__", None)
    made = inspect.isclass(found) or inspect.isfunction(found) or inspect.ismethod(found)
    return made and isinstance(home, str) and f"{home}.".startswith(f"{entry}.")


def _check_logger(node: Mapping[str, Any], place: str, path: Path) -> None:
    """Refuses a logger that writes outside of the run folder."""
    for key, value in node.items():
        at = f"{path}: {place}.{key} must"
        if key == "log_dir":
            if not (isinstance(value, str) and _IN_RUN_FOLDER.fullmatch(value)):
                hint = f"trust=[{node['_target_']}] lets it write there"
                raise ValueError(
                    f"{at} lie in the run folder, {{folder}}, got {_shown(value)}; {hint}."
                )
        elif key != "_target_" and not _is_name(value, _FILLED_NAME):
            raise ValueError(f"{at} be a plain name or number, got {_shown(value)}.")
    if "log_dir" not in node:
        raise ValueError(f"{path}: {place}.log_dir must lie in the run folder, {{folder}}.")


def _is_name(value: Any, pattern: re.Pattern[str] = _NAME) -> bool:
    return isinstance(value, (bool, int, float)) or (
        isinstance(value, str) and pattern.fullmatch(value) is not None
    )


def _is_own(module: str) -> bool:
    """Whether a module is neither Python's nor installed from a package; it is not imported."""
    if module in {"zfall", "recipes", *sys.stdlib_module_names}:
        return False
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):
        return True
    return spec is None or not {"site-packages", "dist-packages"} & set(
        Path(spec.origin or "").parts
    )


def _shown(value: Any) -> str:
    """A value of a file in a message: short, on one line, without control characters."""
    text = value if isinstance(value, str) else repr(value)
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 100 else f"{text[:97]}..."
