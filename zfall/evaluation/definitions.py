"""What a battery is: its numbers, read from ``recipes/battery``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from hydra.errors import ConfigCompositionException
from omegaconf import DictConfig, OmegaConf

from zfall.configs import compose_config, options_of
from zfall.evaluation.followers import followers_of
from zfall.evaluation.kinds import kind_of


@dataclass(frozen=True, kw_only=True)
class Battery:
    """Definition of a battery; ``recipes/battery/planar.yaml`` explains the fields."""

    version: int
    name: str
    kind: str
    measures: tuple[str, ...]
    point: str | tuple[str, ...]
    directions: int
    impulses: tuple[float, ...]
    starts: int
    start_noise: float
    push_time: float
    duration: float | tuple[float, ...]
    end_time: float
    aftermath: float | None
    max_tilt: float
    min_height: float
    foot_friction: float | None
    mass_factor: tuple[float, float] | None
    load: tuple[float, float] | None
    resolution: float | None
    interval: float | None
    forces: tuple[tuple[float, float], ...]
    force_starts: int

    @property
    def points(self) -> tuple[str, ...]:
        """Where it pushes."""
        return (self.point,) if isinstance(self.point, str) else self.point

    @property
    def durations(self) -> tuple[float, ...]:
        """How long [s]."""
        return self.duration if isinstance(self.duration, tuple) else (self.duration,)


def load_battery(name: str, **options: Any) -> Battery:
    """A battery by name, with some of its numbers replaced: ``load_battery("planar", starts=5)``.

    Args:
        name: of a yaml in ``recipes/battery``, or in the folder ``battery`` of one that
            ``--config-dir`` names.
        options: fields of ``Battery``.

    Raises:
        ValueError: if there is no such battery or option, or a number does not fit.
    """
    return battery_of(table_of(name), **options)


def table_of(name: str) -> DictConfig:
    """The yaml of a battery, as it stands.

    Raises:
        ValueError: if there is none.
    """
    known = options_of("battery")
    if name not in known:
        raise ValueError(f"battery must be one of {', '.join(known)}, got {name!r}.")
    try:
        table: DictConfig = compose_config([f"battery={name}"], recipe="evaluate").battery
    except ConfigCompositionException as error:
        raise ValueError(f"battery {name}: {error}") from error
    return table


def battery_of(table: DictConfig | Mapping[str, Any], **options: Any) -> Battery:
    """A battery from its table, with some of its numbers replaced.

    Raises:
        ValueError: if a key is missing or unknown, or a number does not fit.
    """
    given: Any = OmegaConf.to_container(table) if isinstance(table, DictConfig) else dict(table)
    names = [field.name for field in fields(Battery)]
    name = given.get("name")
    if missing := [key for key in names if key not in given]:
        raise ValueError(
            f"battery {name} must have {missing[0]}, as defaults: [planar, _self_] gives it."
        )
    if unknown := sorted({*given, *options} - set(names)):
        raise ValueError(f"options of battery {name} are {', '.join(names)}, got {unknown[0]}.")
    numbers = given | options
    for key, (rule, fits) in _RULES.items():
        if not fits(numbers[key]):
            raise ValueError(f"{key} must be {rule}, got {numbers[key]}.")
    if not numbers["impulses"] or min(numbers["impulses"]) <= 0:
        raise ValueError(f"impulses must be positive, at least one, got {numbers['impulses']}.")
    numbers["impulses"] = [float(impulse) for impulse in numbers["impulses"]]
    for key in ("directions", "starts"):
        if numbers[key] < 1:
            raise ValueError(f"{key} must be at least 1, got {numbers[key]}.")
    battery = Battery(**{key: _frozen(value) for key, value in numbers.items()})
    if min(battery.durations, default=0.0) <= 0:
        raise ValueError(f"duration must be positive, got {battery.duration}.")
    over = battery.push_time + max(battery.durations)
    if not battery.end_time > over:
        raise ValueError(
            f"end_time must be later than the end of the push, {over:g} s, got {battery.end_time}."
        )
    kind_of(battery).check(battery)
    followers_of(battery)
    return battery


def check_single(battery: Battery, *keys: str) -> None:
    """Refuses several push points or durations, for kinds that do not tell them apart."""
    for key in keys:
        if isinstance(getattr(battery, key), tuple):
            raise ValueError(
                f"{key} of battery {battery.name} must be one, got {getattr(battery, key)}."
            )


def check_unused(battery: Battery, *keys: str) -> None:
    """Refuses numbers that a kind does not read."""
    for key in keys:
        if getattr(battery, key) not in (None, ()):
            raise ValueError(
                f"{key} must be null: {battery.kind.rpartition('.')[2]}, the kind of battery "
                f"{battery.name}, does not read it; got {getattr(battery, key)}."
            )


def _frozen(value: Any) -> Any:
    if isinstance(value, str) or not isinstance(value, Sequence):
        return value
    return tuple(map(_frozen, value))


def _number(value: Any) -> bool:
    return type(value) in (int, float)


def _text(value: Any) -> bool:
    return isinstance(value, str) and bool(value)


def _all(values: Any, fits: Callable[[Any], bool]) -> bool:
    return not isinstance(values, str) and isinstance(values, Sequence) and all(map(fits, values))


def _pair(value: Any) -> bool:
    return _all(value, _number) and len(value) == 2


_RULES: dict[str, tuple[str, Callable[[Any], bool]]] = {
    **dict.fromkeys(("name", "kind"), ("a name", _text)),
    "measures": ("a list of classes by their dotted paths", lambda value: _all(value, _text)),
    **dict.fromkeys(
        ("version", "directions", "starts", "force_starts"),
        ("a whole number", lambda value: type(value) is int),
    ),
    **dict.fromkeys(
        ("start_noise", "push_time", "end_time", "max_tilt", "min_height"), ("a number", _number)
    ),
    **dict.fromkeys(
        ("aftermath", "foot_friction", "resolution", "interval"),
        ("a number or null", lambda value: value is None or _number(value)),
    ),
    **dict.fromkeys(
        ("mass_factor", "load"),
        ("two numbers, [0.8,1.2], or null", lambda value: value is None or _pair(value)),
    ),
    "impulses": ("a list of numbers, [0.2,0.4]", lambda value: _all(value, _number)),
    "duration": (
        "a number or a list of numbers",
        lambda value: _number(value) or _all(value, _number),
    ),
    "point": (
        "a name, or a list of at least one",
        lambda value: _text(value) or (bool(value) and _all(value, _text)),
    ),
    "forces": ("a list of pairs, [[20,0],[0,-20]]", lambda value: _all(value, _pair)),
}
