"""A robot's hardware as a table of its own, put in the place of that of any env.

A transform that models hardware declares on its class which part of it: ``hardware = "commands"``
(the way from targets to motors), ``"physics"`` or ``"sensors"``. An estimator, which is software of
the robot, declares what it ``estimates``.
"""

from collections.abc import Mapping
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, OmegaConf, open_dict
from torchrl.envs import TransformedEnv

from zfall.envs.make import in_place, left_out
from zfall.errors import at, in_one_line
from zfall.static_checks import check_nodes

PARTS = ("commands", "physics", "sensors")
PREFIX = "world_"  # of the names of its transforms, so that they meet no others

World = Mapping[str, Any]


def check_world(world: World | None, place: str = "world") -> None:
    """Refuses what is no world.

    Args:
        world: tables ``base_env``, ``commands``, ``physics`` and ``sensors``, each may be missing.
        place: full key, for messages.

    Raises:
        ValueError: on another table, or values that do not fit.
    """
    if world is None:
        return
    known = ("base_env", *PARTS)
    if not isinstance(world, Mapping) or (unknown := [key for key in world if key not in known]):
        found = unknown[0] if isinstance(world, Mapping) else world
        raise ValueError(f"{place} must be null or have tables {', '.join(known)}, got {found}.")
    for key, table in world.items():
        if not isinstance(table, Mapping):
            raise ValueError(f"{place}.{key} must be a table, got {table}.")
    for part in PARTS:  # under a name that lets them have a place, as in an env
        check_nodes({"transforms": dict(_of(world, part))}, f"{place}.{part}")
    check_nodes(dict(world.get("base_env", {})), f"{place}.base_env")
    try:  # its servos, whose annotations do not say all
        instantiate(dict(world.get("base_env", {})), _convert_="all")
    except InstantiationException as error:
        raise ValueError(at(f"{place}.base_env", in_one_line(error))) from error


def in_world(env_cfg: DictConfig, world: World | None) -> DictConfig:
    """The config of an env with the hardware of a world in the place of its own.

    Values of ``base_env`` replace the env's. Each of the other tables replaces all transforms that
    are hardware of its kind: ``commands`` act last on the way to the motors, ``sensors`` stand
    before all that reads what is measured. An estimator of the world gives way to one of the env
    for the same quantity, which belongs to the policy that was trained with it, unless that is in
    ``training_only``.

    Args:
        env_cfg: as in ``recipes/env``.
        world: see ``check_world``; ``None`` leaves the config as it is.

    Raises:
        ValueError: if a transform of the env has a name that begins with ``world_``.
    """
    if world is None:
        return env_cfg
    gives_way = replaced(env_cfg, world)
    own = {
        str(name): None if name in gives_way else transform
        for name, transform in in_place(env_cfg.transforms).items()
    }
    if taken := [name for name in own if name.startswith(PREFIX)]:
        raise ValueError(f"transforms.{taken[0]} must not begin with {PREFIX}, rename it.")
    gone = left_out(OmegaConf.select(env_cfg, "training_only", default={}))
    estimated = {_declared(own[name], "estimates") for name in own.keys() - {*gone}} - {None}
    sensors = {
        name: transform
        for name, transform in _named(world, "sensors").items()
        if _declared(transform, "estimates") not in estimated
    }
    table = sensors | own | _named(world, "physics") | _named(world, "commands")
    named = dict.fromkeys(map(str, env_cfg.transforms))  # in training_only: they stay, as null
    new = env_cfg.copy()  # keeps what it refers to outside of itself
    with open_dict(new):
        for key, value in world.get("base_env", {}).items():
            new.base_env[key] = value
        new.transforms = OmegaConf.create(
            table | {k: v for k, v in named.items() if k not in table}
        )
    return new


def replaced(env_cfg: DictConfig, world: World | None) -> list[str]:
    """Names of the transforms of an env that a world has its own hardware for."""
    parts = [part for part in PARTS if world is not None and part in world]
    return [
        str(name)
        for name, transform in env_cfg.transforms.items()
        if _declared(transform, "hardware") in parts
    ]


def privileged(env: TransformedEnv) -> list[str]:
    """Quantities that the software of a robot reads and no sensor of an env measures, sorted.

    They are the true ones of the base env. Software is what declares that it reads what is
    ``measured``: observations, estimators, predictors.
    """
    there = set(env.base_env.observation_spec.keys())
    known = {key[1] for t in env.transform for key in t.out_keys or () if _is_measured(key)}
    read: set[str] = set()
    for transform in env.transform:
        reads = getattr(transform, "measured", ())  # keys, or true: all that it reads
        read |= {str(key) for key in (transform.in_keys if reads is True else reads or ())}
    return sorted(read & there - known)


def _is_measured(key: object) -> bool:
    return isinstance(key, tuple) and len(key) == 2 and key[0] == "measured"


def _declared(transform: Mapping[str, Any] | None, attribute: str) -> str | None:
    """What the class of a transform declares."""
    if not transform:
        return None
    value: str | None = getattr(get_object(transform["_target_"]), attribute, None)
    return value


def _of(world: World, part: str) -> Mapping[str, Any]:
    table: Mapping[str, Any] = world.get(part, {})
    return {name: transform for name, transform in table.items() if transform is not None}


def _named(world: World, part: str) -> dict[str, Any]:
    """The transforms of a table under their names in an env, places among them included."""
    table = _of(world, part)
    moved = {
        name: {**each, "before": PREFIX + each["before"]} if "before" in each else dict(each)
        for name, each in table.items()
    }
    return {PREFIX + name: transform for name, transform in moved.items()}
