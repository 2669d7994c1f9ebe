"""The yaml table of a task: what may be changed in it, and what two of them must share."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, OmegaConf, open_dict

from zfall.configs import compose_config, nodes_of, options_of, plain_containers
from zfall.fingerprints import digest, file_digest
from zfall.robots import DEFAULT, Robot
from zfall.simulation.model import identity_of
from zfall.static_checks import check_nodes

INTERFACE = ("action", "observation")  # transforms by which a policy acts and sees


def robot_of(cfg: DictConfig) -> Robot:
    """The robot of the config of an env."""
    if not isinstance(cfg.base_env, DictConfig):
        raise ValueError(f"env.base_env must be a table, got {cfg.base_env}.")
    robot = cfg.base_env.get("robot")
    return DEFAULT if robot is None else instantiate(robot, _convert_="all")


def changed(env_cfg: DictConfig, changes: Sequence[str]) -> DictConfig:
    """The env's config with some of its values replaced, ``transforms.mode.angle=0.4``.

    A table with the ``_target_`` of another class replaces the one that was there, others are
    merged into it.
    ``servo=NAME`` gives it the servos of ``recipes/servo``; values of these can be changed after.
    ``robot=NAME`` gives it a robot of ``recipes/robot``.

    Raises:
        ValueError: on a key that is not there, a value that it cannot have, servos that there are
            not, or something else than a list.
    """
    if isinstance(changes, str) or not isinstance(changes, Sequence):
        raise ValueError(f"change must be a list, [{changes}], got {changes}.")
    new = env_cfg.copy()  # keeps what it refers to outside of itself
    for change in map(str, changes):
        key, given, text = change.partition("=")
        if not given:
            raise ValueError(f"change must be KEY=VALUE, got {change}.")
        if key in ("servo", "robot"):
            new = with_servos(new, text) if key == "servo" else with_robot(new, text)
            continue
        if OmegaConf.select(new, key, default="missing") == "missing":
            raise ValueError(f"change must name a value of the env, there is no {key}.")
        value = OmegaConf.select(OmegaConf.from_dotlist([change]), key)
        target = value.get("_target_") if isinstance(value, DictConfig) else None
        whole = target is not None and target != OmegaConf.select(new, f"{key}._target_")
        OmegaConf.update(new, key, value, merge=not whole, force_add=whole)
    if changes:
        check_nodes(plain_containers(new))
    return new


def with_servos(env_cfg: DictConfig, name: str) -> DictConfig:
    """The env's config with the servos of ``recipes/servo/NAME.yaml``.

    Raises:
        ValueError: on an unknown name.
    """
    names = options_of("servo")
    if name not in names:
        raise ValueError(f"servo must be one of {', '.join(names)}, got {name!r}.")
    servos = compose_config([f"servo={name}"]).env.base_env.get("servos")
    new = env_cfg.copy()
    with open_dict(new):
        new.base_env.pop("servos", None)
        if servos is not None:
            new.base_env.servos = servos
    return new


def with_robot(env_cfg: DictConfig, name: str) -> DictConfig:
    """The env's config with the robot of ``recipes/robot/NAME.yaml`` and its own servos.

    Raises:
        ValueError: on an unknown name.
    """
    names = options_of("robot")
    if name not in names:
        raise ValueError(f"robot must be one of {', '.join(names)}, got {name!r}.")
    given = compose_config([f"robot={name}"]).env.base_env
    new = env_cfg.copy()
    with open_dict(new):
        new.base_env.pop("robot", None)
        if given.get("robot") is not None:
            new.base_env.robot, new.base_env.servos = given.robot, None
    return new


def keep(env_cfg: DictConfig, names: Sequence[str]) -> DictConfig:
    """The env's config with some of what evaluation leaves out kept on: noise, delays.

    Raises:
        ValueError: on a name that is not left out.
    """
    training_only = OmegaConf.select(env_cfg, "training_only", default={})
    unknown = [name for name in names if name not in training_only]
    if unknown:
        raise ValueError(
            f"keep must name what evaluation leaves out ({', '.join(training_only)}), "
            f"got {unknown[0]}."
        )
    kept = env_cfg.copy()
    for name in names:
        kept.training_only[name] = False
    return kept


def declaring(env_cfg: DictConfig, attribute: str) -> list[str]:
    """Names of the transforms of an env whose class declares an attribute that is true.

    ``acts_by_itself``: it moves the robot without an action. ``replaced_in_batteries``: it starts
    or pushes, which a battery does itself.
    """
    return [
        str(name)
        for name, transform in env_cfg.transforms.items()
        if transform and getattr(get_object(transform["_target_"]), attribute, False)
    ]


def check_same_interface(
    configs: dict[str, DictConfig], sees: Mapping[str, str] | None = None, *, rate: bool = True
) -> None:
    """Refuses policies, by name the config of each, that do not see or do the same.

    Args:
        configs: by name.
        sees: by name the vector that counts in place of ``observation``, if it is another.
        rate: whether they must do so equally often.

    Raises:
        ValueError: naming what differs, or a vector that is not there.
    """
    names = " and ".join(configs)
    seen = dict.fromkeys(configs, "observation") | dict(sees or {})
    rates = ["base_env.control_dt"] if rate else []
    for key in (*(f"transforms.{name}" for name in INTERFACE), *rates):
        if key == "transforms.observation" and {*seen.values()} != {"observation"}:
            values = [_written_to(cfg.env, seen[name], name) for name, cfg in configs.items()]
        else:
            values = [OmegaConf.select(cfg.env, key) for cfg in configs.values()]
        if any(value != values[0] for value in values):
            key, values = _where_they_differ(key, values)
            found = " and ".join(map(str, values))
            other = [f"of {name} that of {vector}" for name, vector in (sees or {}).items()]
            which = f" ({', '.join(other)})" if other and "observation" in key else ""
            raise ValueError(f"{names} must have the same env.{key}{which}, got {found}.")


def _written_to(env_cfg: DictConfig, key: str, name: str) -> DictConfig:
    """The transform of an env, called ``name``, that writes this vector.

    Without its key, and without whether it reads what is measured or what is true.
    """
    for transform in env_cfg.transforms.values():
        if isinstance(transform, DictConfig) and transform.get("out_key") == key:
            return OmegaConf.create(
                {k: v for k, v in transform.items() if k not in ("out_key", "measured")}
            )
    written = [t.out_key for t in env_cfg.transforms.values() if t and t.get("out_key")]
    raise ValueError(f"{name} must have a vector {key} in its env, has {', '.join(written)}.")


def _where_they_differ(key: str, values: list[Any]) -> tuple[str, list[Any]]:
    """The first key inside of configs that are not equal whose values differ, and these."""
    while all(isinstance(value, DictConfig) for value in values):
        inside = dict.fromkeys(str(name) for value in values for name in value)
        found = {name: [value.get(name, "nothing") for value in values] for name in inside}
        differing = (n for n, those in found.items() if any(x != those[0] for x in those))
        name = next(differing, None)
        if name is None:
            break
        key, values = f"{key}.{name}", found[name]
    return key, values


def contents_of(config: Mapping[str, Any]) -> dict[str, str]:
    """What values of a config stand for that lies outside of it: files, the robot, its servos.

    Files are those that classes and functions name by ``reads_files``.

    Args:
        config: plain containers; ``env`` is the env's table.

    Returns:
        Digests by full key, as ``zfall.meaning.meaning`` takes them.
    """
    env_cfg = OmegaConf.create(config["env"])
    robot = robot_of(env_cfg)
    contents = {"env.base_env.identity": identity_of(robot)}
    if env_cfg.base_env.get("servos") is not None:  # their numbers lie in the package
        servos = instantiate(env_cfg.base_env.servos, _convert_="all")
        numbers = {joint: asdict(each) for joint, each in servos.items()}
        contents["env.base_env.servos"] = digest(numbers)
    for place, node in nodes_of(config):
        try:
            built = get_object(str(node["_target_"]))
        except (ImportError, ValueError):  # whoever builds it says so
            continue
        paths = built.files_read(node, robot) if hasattr(built, "files_read") else ()
        if found := [file_digest(path) for path in paths if path.is_file()]:
            contents[f"{place}.{built.files_argument}"] = " ".join(found)
    return contents
