"""What a battery may be, and what is refused."""

import math

import pytest
from omegaconf import OmegaConf

from zfall.configs import options_of
from zfall.evaluation.definitions import battery_of, load_battery, table_of


def test_unknown_battery_and_option_are_refused():
    with pytest.raises(
        ValueError, match="battery must be one of .*planar, planar_payload.*got 'linear'"
    ):
        load_battery("linear")
    with pytest.raises(ValueError, match="battery.pont is not a key .*did you mean point"):
        load_battery("planar", pont="torso")


def test_variants_change_the_physics_and_nothing_else():
    planar = load_battery("planar")
    for name in ("planar_slippery", "planar_payload"):
        variant = load_battery(name)
        same = {key for key in vars(planar) if getattr(planar, key) == getattr(variant, key)}
        assert set(vars(planar)) - same <= {"name", "foot_friction", "mass_factor", "load"}
        assert len(same) < len(vars(planar)) - 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": "abc"}, "starts must be a whole number, got abc"),
        ({"starts": 2.5}, "starts must be a whole number, got 2.5"),
        ({"directions": True}, "directions must be a whole number, got true"),
        ({"impulses": 0.4}, "battery.impulses must be a list, .*got 0.4"),
        ({"impulses": [0.4, "x"]}, "battery.impulses.1 must be a number, got x"),
        ({"end_time": "late"}, "end_time must be a number, got late"),
        ({"duration": "short"}, "battery.duration must be a number or a list.*, got short"),
    ],
)
def test_options_of_another_kind_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        load_battery("planar", **options)


def test_durations_and_sizes_that_make_no_push_are_refused():
    with pytest.raises(ValueError, match="battery.duration must be positive and finite, got 0"):
        load_battery("planar", duration=0)
    with pytest.raises(ValueError, match="battery.impulses.1 must be positive"):
        load_battery("spherical", impulses=[0.2, -0.1])


def _with(value, number):
    """The same with a number in the place of each of its numbers, one at a time."""
    if isinstance(value, list):
        for at, each in enumerate(value):
            for changed in _with(each, number):
                yield [*value[:at], changed, *value[at + 1 :]]
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield number


@pytest.mark.parametrize("name", options_of("battery"))
def test_every_number_is_finite(name):
    table = OmegaConf.to_container(table_of(name))
    table |= {key: 1.0 for key in ("aftermath", "foot_friction", "interval") if table[key] is None}
    table |= {key: [1.0, 1.0] for key in ("mass_factor", "load") if table[key] is None}
    tried = 0
    for key, value in table.items():
        for number in (math.nan, math.inf, -math.inf):
            for changed in _with(value, number):
                with pytest.raises(ValueError, match=rf"battery\.{key}\b.* must .*got -?(nan|inf)"):
                    battery_of(table | {key: changed})
                tried += 1
    assert tried >= 3 * 17


@pytest.mark.parametrize("end", [3.0, 3.1])
def test_a_trial_does_not_end_before_its_push_does(end):
    """The push lasts from 3.0 to 3.1 s."""
    with pytest.raises(ValueError, match="end_time must be later than the end of the push, 3.1 s"):
        load_battery("planar", end_time=end)
    assert load_battery("planar", end_time=3.2).end_time == 3.2


@pytest.mark.parametrize("name", ["planar", "envelope"])
def test_pushes_of_several_durations_are_not_mixed(name):
    with pytest.raises(ValueError, match="battery.duration must be one"):
        load_battery(name, duration=[0.1, 0.4])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "zfall.evaluation.kinds.planar.Round"}, "battery.kind .*got zfall.*Round"),
        ({"measures": ["nowhere.Effort"]}, "battery.measures .*got nowhere.Effort"),
        ({"measures": "zfall.evaluation.effort.Effort"}, "measures must be a list"),
        ({"slope": 0.1}, "battery.slope is not a key"),
        ({"kind": "math"}, "battery.kind must name a class, got math"),
        ({"end_time": {"_target_": "os.getcwd"}}, "battery.end_time must be plain"),
        ({"max_tilt": "low"}, "max_tilt .*got low"),
        ({"mass_factor": [0.8]}, "mass_factor .*a list of 2, got .*0.8"),
        ({"forces": [20, 0]}, "forces.0 .*got 20"),
        ({"resolution": 0.1}, "resolution must be null.*Planar.*got 0.1"),
        ({"interval": 3.0}, "interval must be null.*got 3.0"),
        ({"forces": [[20, 0]]}, "forces must be null"),
    ],
)
def test_tables_that_make_no_battery_are_refused(change, message):
    table = OmegaConf.to_container(table_of("planar"))
    with pytest.raises(ValueError, match=message):
        battery_of(table | change)


def test_options_may_come_from_a_config():
    options = OmegaConf.create({"impulses": [0.2], "point": ["torso"]})
    battery = load_battery("envelope", **dict(options.items()))
    assert (battery.impulses, battery.point) == ((0.2,), ("torso",))


def test_a_number_that_is_missing_is_named():
    table = OmegaConf.to_container(table_of("planar"))
    table.pop("aftermath")
    with pytest.raises(ValueError, match="planar must have aftermath"):
        battery_of(table)


@pytest.mark.parametrize(
    ("battery", "options", "message"),
    [
        ("envelope", {"resolution": 3.0}, "battery.resolution must be below 2.*got 3.0"),
        ("envelope", {"interval": 1.0}, "interval must be null"),
        ("spherical", {"interval": None}, "battery.interval must be.*got null"),
        ("spherical", {"resolution": 0.1}, "resolution must be null"),
    ],
)
def test_numbers_that_a_kind_does_not_read_are_refused(battery, options, message):
    with pytest.raises(ValueError, match=message):
        load_battery(battery, **options)
