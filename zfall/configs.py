"""The yaml of the recipes, found and composed wherever zfall is installed.

In a clone it lies in ``recipes/`` beside the package, in an installed wheel in ``zfall/recipes``.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.utils import get_method
from omegaconf import DictConfig, OmegaConf

_PACKAGE = Path(__file__).parent


def config_folder() -> Path:
    """The folder of the recipes' yaml."""
    installed = _PACKAGE / "recipes"
    return installed if installed.is_dir() else _PACKAGE.parent / "recipes"


def options_of(group: str) -> list[str]:
    """Names of the yaml files of a group, ``options_of("env")``.

    Inside a running recipe those of folders that ``--config-dir`` adds are among them.
    """
    hydra = GlobalHydra.instance().hydra
    if hydra is not None and _recipe_runs():
        return sorted(hydra.config_loader.get_group_options(group))
    return sorted(path.stem for path in (config_folder() / group).glob("*.yaml"))


def compose_config(overrides: Sequence[str] = (), recipe: str = "train") -> DictConfig:
    """The config of a recipe as the shell would compose it.

    Inside a running recipe its own search path counts, with folders that ``--config-dir`` adds.

    Args:
        overrides: as on the command line.
        recipe: whose config.

    Raises:
        HydraException: on overrides that do not fit.
    """
    if _recipe_runs():
        return compose(recipe, overrides=list(overrides))
    with _without_other_hydra(), initialize_config_dir(str(config_folder()), version_base=None):
        return compose(recipe, overrides=list(overrides))


def plain_containers(cfg: Any) -> Any:
    """Dicts and lists of a config, with what it refers to in its place.

    Raises:
        OmegaConfBaseException: on a reference that leads nowhere.
    """
    return OmegaConf.to_container(cfg, resolve=True)


def nodes_of(config: Any, place: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The tables of a config that name a class or function, outer ones first.

    Args:
        config: plain containers, as ``OmegaConf.to_container(cfg, resolve=True)`` gives.
        place: full key of ``config`` itself.

    Yields:
        Full key and table of each that has a ``_target_``; entries of lists have numbers as keys.
    """
    if isinstance(config, Mapping):
        if "_target_" in config:
            yield place, config
        entries = [(str(key), value) for key, value in config.items()]
    elif isinstance(config, list | tuple):
        entries = [(str(number), value) for number, value in enumerate(config)]
    else:
        return
    for key, value in entries:
        yield from nodes_of(value, f"{place}.{key}" if place else key)


def _sized(value: float, unit: str, *, _parent_: Any) -> float:
    """``${sized:0.1,time}``: 0.1 s for the default robot, as much for one of another size."""
    node = _parent_
    while node is not None and not (isinstance(node, DictConfig) and "base_env" in node):
        node = node._get_parent()
    base = None if node is None else node.base_env
    robot = base.get("robot") if isinstance(base, DictConfig) else None  # another is refused later
    if robot is None:
        return value
    size: float = get_method("zfall.robots.units.sized")(value, unit, plain_containers(robot))
    return size


def _of_policy(run: str, key: str) -> Any:
    """``${policy:twin,env.base_env.control_dt}``: that value of the config of a policy."""
    return get_method("zfall.policies.load.config_value")(run, key)


def _control_dt(parent: Any) -> float:
    """Length of a control step [s] of the env in or next to which a value stands."""
    while parent is not None:
        for key in ("base_env.control_dt", "env.base_env.control_dt"):
            if isinstance(parent, DictConfig) and OmegaConf.select(parent, key) is not None:
                return float(OmegaConf.select(parent, key))
        parent = parent._get_parent()
    raise ValueError("env.base_env must have a control_dt for times to be counted in steps.")


def _decisions(seconds: float, *, _parent_: Any) -> int:
    """``${decisions:1.2}``: how many control steps 1.2 s are."""
    return round(seconds / _control_dt(_parent_))


def _decay(seconds: float, *, _parent_: Any) -> float:
    """``${decay:1.3}``: what a control step leaves of something with this time constant [s]."""
    return math.exp(-_control_dt(_parent_) / seconds)


def _per_decision(rate: float, *, _parent_: Any) -> float:
    """``${per_decision:5.0}``: what a control step has of 5.0 a second."""
    return rate * _control_dt(_parent_)


_RESOLVERS: Mapping[str, Callable[..., Any]] = {
    "sized": _sized,
    "policy": _of_policy,
    "decisions": _decisions,
    "decay": _decay,
    "per_decision": _per_decision,
}
for _name, _resolver in _RESOLVERS.items():
    OmegaConf.register_new_resolver(_name, _resolver, replace=True)


def _recipe_runs() -> bool:
    """Whether the hydra that runs, if any, is that of a recipe of ours."""
    hydra = GlobalHydra.instance().hydra
    return hydra is not None and "quickstart" in hydra.config_loader.get_group_options("experiment")


@contextmanager
def _without_other_hydra() -> Iterator[None]:
    """Sets aside the hydra of the program around us: there can be only one at a time."""
    other = GlobalHydra.instance().hydra
    GlobalHydra.instance().hydra = None
    try:
        yield
    finally:
        GlobalHydra.instance().hydra = other
