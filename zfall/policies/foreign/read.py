"""From the yaml of a policy of another framework to its actor and its task."""

import inspect
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict

from hydra.errors import HydraException
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from zfall.complaints import check_table
from zfall.configs import compose_config, options_of, plain_containers
from zfall.envs.tables import changed, declaring
from zfall.envs.transforms.foreign.terms import TERMS
from zfall.errors import check_keys, in_one_line
from zfall.policies.foreign.actor import ForeignActor
from zfall.policies.foreign.network import NetworkTable, read_network
from zfall.trust import config_of_file
from zfall.values import Bounds, Count, Name, Names, NotNegative, Positive

_TRANSFORMS = "zfall.envs.transforms"
_OF_ENTRY = ("scale", "clip", "history")  # the rest of a term's line are values of its class
# Where we put what the yaml calls otherwise.
_OURS = (
    (re.compile(r"^transforms\.observation\.terms\.(\d+)(\.of)?"), r"observation.\1"),
    (re.compile(r"^transforms\.\w+(: |\.)"), ""),
)
_KEPT = ("terminations", "limit")  # of the task that the policy is put into


class Rates(TypedDict):
    """``rates``: of the policy, and of the physics if it is not the task's [Hz]."""

    control: Positive
    physics: NotRequired[Positive]


class Action(TypedDict):
    """``action``: what its numbers do."""

    scale: float | Sequence[float] | Mapping[Name, float]
    reference: NotRequired[Literal["stand"] | Sequence[float] | Mapping[Name, float]]
    clip: NotRequired[Positive | Bounds | None]
    delay: NotRequired[NotNegative]


class History(TypedDict):
    """``history``: see ``ForeignObservation``."""

    steps: NotRequired[Count]
    stack: NotRequired[Literal["terms", "frames"]]
    oldest: NotRequired[Literal["first", "last"]]
    start: NotRequired[Literal["repeat", "zeros"]]
    clip: NotRequired[Bounds | None]


class Description(TypedDict):
    """The yaml."""

    network: Name | NetworkTable
    rates: Rates
    joints: Names
    action: Action
    observation: Sequence[Name | Mapping[str, Any]]
    history: NotRequired[History]
    env: NotRequired[Name]
    robot: NotRequired[Name]


def read_foreign(path: Path, changes: Sequence[str] = ()) -> tuple[ForeignActor, DictConfig]:
    """The actor that a yaml describes, and the config with its ``env``.

    Args:
        path: of the yaml.
        changes: values of the env to replace.

    Raises:
        ValueError: if a file is missing or holds something else, a key or value does not fit, the
            robot lacks a joint, a term is unknown, or the network takes or gives other sizes.
    """
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"run must be the yaml of a policy, cannot read {path}.") from error
    table = plain_containers(config_of_file(text, path))
    with _in_one_line(path):
        check_table(table, Description)
        network = table["network"]
        given: NetworkTable = {"file": network} if isinstance(network, str) else network
        read = read_network(path.parent / given["file"], given)
        env_cfg = changed(_env(table), list(changes))
        env = instantiate(env_cfg, base_env={"num_envs": 1}, training=False)
        sizes = env.transform.by_name["observation"].sizes()
        terms = ", ".join(f"{name} {size}" for name, size in sizes.items())
        read.check(sum(sizes.values()), terms, len(table["joints"]))
    return ForeignActor(read, _clip(table["action"])), OmegaConf.create({"env": env_cfg})


@contextmanager
def _in_one_line(path: Path) -> Iterator[None]:
    """What does not fit in one line, with the file in front."""
    try:
        yield
    except (ValueError, HydraException) as error:
        reason = in_one_line(error)
        for ours, theirs in _OURS:
            reason = ours.sub(theirs, reason)
        raise ValueError(f"{path}: {reason}") from error


def _env(table: Mapping[str, Any]) -> DictConfig:
    """The task of the yaml, in which the policy sees and acts as it did."""
    chosen = {"env": table.get("env", "push_recovery")}
    chosen |= {"robot": table["robot"]} if "robot" in table else {}
    for group, name in chosen.items():
        if name not in (names := options_of(group)):
            raise ValueError(f"{group} must be one of {', '.join(names)}, got {name}.")
    overrides = [f"{group}={name}" for group, name in chosen.items()]
    task = compose_config([*overrides, "num_envs=64"]).env
    starts = declaring(task, "replaced_in_batteries")
    plain = plain_containers(task)
    base = plain["base_env"] | _steps(table["rates"], plain["base_env"]["physics_dt"])
    joints, action = table["joints"], table["action"]
    interface = {"joints": joints, "reference": _by_joint(action.get("reference"), joints)}
    target = {
        "_target_": f"{_TRANSFORMS}.foreign.ForeignJointTarget",
        "scale": _scales(action["scale"], joints),
    }
    history = {"history" if k == "steps" else k: v for k, v in table.get("history", {}).items()}
    observation = {
        "_target_": f"{_TRANSFORMS}.foreign.ForeignObservation",
        "terms": [_entry(term, number) for number, term in enumerate(table["observation"])],
    }
    transforms = {name: plain["transforms"][name] for name in starts}
    transforms["action"] = target | interface
    if action.get("delay"):
        delay = [action["delay"]] * 2
        transforms["delay"] = {
            "_target_": f"{_TRANSFORMS}.actions.ActuatorDelay",
            "delay": delay,
            "max_delay": delay[0],
        }
    kept = (name for name in _KEPT if plain["transforms"].get(name))
    transforms |= {name: plain["transforms"][name] for name in kept}
    transforms["observation"] = observation | interface | history
    transforms["init"] = {"_target_": "torchrl.envs.InitTracker"}
    return OmegaConf.create(
        {
            "_target_": plain["_target_"],
            "_recursive_": False,
            "base_env": base,
            "transforms": transforms,
            "training_only": dict.fromkeys(starts, True),
        }
    )


def _steps(rates: Rates, physics_dt: float) -> dict[str, float]:
    """Control and physics step [s]; ``physics_dt`` is the task's."""
    control, physics = rates["control"], rates.get("physics", 1.0 / physics_dt)
    count = round(physics / control)
    if count < 1 or abs(physics / control - count) > 1e-6:
        raise ValueError(
            f"rates.physics must be a whole number of times rates.control, got {physics:g} for "
            f"{control:g}; {max(count, 1) * control:g} would be."
        )
    return {"control_dt": 1.0 / control, "physics_dt": 1.0 / physics}


def _entry(term: str | Mapping[str, Any], number: int) -> dict[str, Any]:
    """A line of ``observation`` as ``ForeignObservation`` takes it."""
    place = f"observation.{number}"
    line = {"term": term} if isinstance(term, str) else dict(term)
    if "_target_" not in line:
        name = str(line.pop("term", "nothing"))
        if name not in TERMS:
            near = get_close_matches(name, TERMS, n=1)
            hint = f"; did you mean {near[0]}?" if near else "."
            raise ValueError(f"{place}.term must be one of {', '.join(TERMS)}, got {name}{hint}")
        made = TERMS[name]
        check_keys(line, {*inspect.signature(made).parameters, *_OF_ENTRY}, f"{place}.")
        line["_target_"] = f"{made.__module__}.{made.__qualname__}"
    entry = {key: line.pop(key) for key in _OF_ENTRY if key in line}
    return {"of": line, **entry}


def _by_joint(reference: Any, joints: Sequence[str]) -> dict[str, float]:
    """Angles by joint [rad]; what it leaves out is the robot's stand."""
    if reference is None or reference == "stand":
        return {}
    if isinstance(reference, Mapping):
        return dict(reference)
    _check_number_of("reference", reference, joints)
    return dict(zip(joints, reference, strict=True))


def _scales(scale: Any, joints: Sequence[str]) -> Any:
    if isinstance(scale, Mapping):
        for name in [*scale, *joints]:
            if name not in scale or name not in joints:
                raise ValueError(
                    f"action.scale must name the joints of the policy ({', '.join(joints)}), each "
                    f"once, {'it lacks' if name in joints else 'got'} {name}."
                )
        return [scale[name] for name in joints]
    if not isinstance(scale, int | float):
        _check_number_of("scale", scale, joints)
    return scale


def _check_number_of(key: str, values: Sequence[float], joints: Sequence[str]) -> None:
    if len(values) != len(joints):
        raise ValueError(
            f"action.{key} must have a number for each of {len(joints)} joints, got {len(values)}."
        )


def _clip(action: Mapping[str, Any]) -> tuple[float, float]:
    clip = action.get("clip")
    if clip is None:
        return -math.inf, math.inf
    return (clip[0], clip[1]) if isinstance(clip, list) else (-clip, clip)
