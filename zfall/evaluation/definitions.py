"""What a battery is: its numbers, read from ``recipes/battery``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, get_type_hints

from hydra.errors import ConfigCompositionException
from omegaconf import DictConfig, OmegaConf

from zfall.complaints import complaint, unknown_key
from zfall.configs import compose_config, nodes_of, options_of, plain_containers
from zfall.envs.worlds import check_world
from zfall.evaluation.followers import followers_of
from zfall.evaluation.kinds import kind_of
from zfall.robots import DEFAULT, Robot
from zfall.robots.units import factor
from zfall.values import ORDERED, Count, Name, NotNegative, Positive, Rule, Whole

_AT_LEAST_ONE = Rule("name at least one", lambda x: len(x) > 0)


@dataclass(frozen=True, kw_only=True)
class Battery:
    """Definition of a battery; ``recipes/battery/planar.yaml`` explains the fields."""

    version: Whole
    name: Name
    kind: Name
    measures: tuple[Name, ...]
    point: Name | Annotated[tuple[Name, ...], _AT_LEAST_ONE]
    directions: Count
    impulses: Annotated[tuple[Positive, ...], _AT_LEAST_ONE]
    starts: Count
    start_noise: NotNegative
    push_time: NotNegative
    duration: Positive | Annotated[tuple[Positive, ...], _AT_LEAST_ONE]
    end_time: Positive
    aftermath: NotNegative | None
    max_tilt: NotNegative
    min_height: float
    foot_friction: NotNegative | None
    mass_factor: Annotated[tuple[Positive, Positive], ORDERED] | None
    load: Annotated[tuple[NotNegative, NotNegative], ORDERED] | None
    resolution: Positive | None
    interval: Positive | None
    forces: tuple[tuple[float, float], ...]
    force_starts: Whole
    commands: tuple[tuple[float, float, float], ...]
    world: Mapping[str, Mapping[str, Any]] | None

    @property
    def points(self) -> tuple[str, ...]:
        """Where it pushes."""
        return (self.point,) if isinstance(self.point, str) else self.point

    @property
    def durations(self) -> tuple[float, ...]:
        """How long [s]."""
        return self.duration if isinstance(self.duration, tuple) else (self.duration,)

    def of_size(self, robot: Robot) -> "Battery":
        """The same battery for a robot of another height: its times go with the root of it.

        Impulses have no dimension anyway. Times are rounded to milliseconds.
        """
        if robot.com_height == DEFAULT.com_height:
            return self
        later = factor(robot, "time")

        def scaled(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(scaled, value))
            return None if value is None else round(later * value, 3)

        times = ("push_time", "duration", "end_time", "aftermath", "interval")
        return replace(self, **{name: scaled(getattr(self, name)) for name in times})


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
    if unknown := sorted(map(str, {*given, *options} - set(names))):
        raise ValueError(unknown_key("battery", unknown[0], names))
    numbers = given | {
        key: plain_containers(value) if OmegaConf.is_config(value) else value
        for key, value in options.items()
    }
    plain = {key: value for key, value in numbers.items() if key != "world"}
    for place, _ in nodes_of(plain, "battery"):
        raise ValueError(f"{place} must be plain, as nothing is built of it, got a _target_.")
    for key, kind in get_type_hints(Battery, include_extras=True).items():
        if wrong := complaint(numbers[key], kind, f"battery.{key}"):
            raise ValueError(wrong)
    numbers["impulses"] = [float(impulse) for impulse in numbers["impulses"]]
    battery = Battery(**{key: _frozen(value) for key, value in numbers.items()})
    over = battery.push_time + max(battery.durations)
    if not battery.end_time > over:
        raise ValueError(
            f"battery.end_time must be later than the end of the push, {over:g} s, "
            f"got {battery.end_time}."
        )
    check_world(battery.world, "battery.world")
    kind_of(battery).check(battery)
    followers_of(battery)
    return battery


def check_single(battery: Battery, *keys: str) -> None:
    """Refuses several push points or durations, for kinds that do not tell them apart."""
    for key in keys:
        if isinstance(getattr(battery, key), tuple):
            raise ValueError(
                f"battery.{key} must be one value: {battery.kind.rpartition('.')[2]} does not tell "
                f"several apart; got {getattr(battery, key)}."
            )


def check_unused(battery: Battery, *keys: str) -> None:
    """Refuses numbers that a kind does not read."""
    for key in keys:
        if getattr(battery, key) not in (None, ()):
            raise ValueError(
                f"battery.{key} must be null: {battery.kind.rpartition('.')[2]}, the kind of "
                f"battery {battery.name}, does not read it; got {getattr(battery, key)}."
            )


def _frozen(value: Any) -> Any:
    if isinstance(value, str) or not isinstance(value, Sequence):
        return value
    return tuple(map(_frozen, value))
