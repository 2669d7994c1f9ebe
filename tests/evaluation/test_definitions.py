"""What a battery may be, and what is refused."""

import pytest
from omegaconf import OmegaConf

from zfall.evaluation.definitions import battery_of, load_battery, table_of


def test_unknown_battery_and_option_are_refused():
    with pytest.raises(
        ValueError, match="battery must be one of .*planar, planar_payload.*got 'linear'"
    ):
        load_battery("linear")
    with pytest.raises(ValueError, match="options of battery planar are .*point.*got pont"):
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
        ({"directions": True}, "directions must be a whole number, got True"),
        ({"impulses": 0.4}, "impulses must be a list of numbers, .*, got 0.4"),
        ({"impulses": [0.4, "x"]}, "impulses must be a list of numbers, .*, got"),
        ({"end_time": "late"}, "end_time must be a number, got late"),
        ({"duration": "short"}, "duration must be a number or a list of numbers, got short"),
    ],
)
def test_options_of_another_kind_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        load_battery("planar", **options)


def test_durations_and_sizes_that_make_no_push_are_refused():
    with pytest.raises(ValueError, match="duration must be positive, got 0"):
        load_battery("planar", duration=0)
    with pytest.raises(ValueError, match="impulses must be positive"):
        load_battery("spherical", impulses=[0.2, -0.1])


@pytest.mark.parametrize("end", [3.0, 3.1])
def test_a_trial_does_not_end_before_its_push_does(end):
    """The push lasts from 3.0 to 3.1 s."""
    with pytest.raises(ValueError, match="end_time must be later than the end of the push, 3.1 s"):
        load_battery("planar", end_time=end)
    assert load_battery("planar", end_time=3.2).end_time == 3.2


@pytest.mark.parametrize("name", ["planar", "envelope"])
def test_pushes_of_several_durations_are_not_mixed(name):
    with pytest.raises(ValueError, match=f"duration of battery {name} must be one"):
        load_battery(name, duration=[0.1, 0.4])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "zfall.evaluation.kinds.planar.Round"}, "battery.kind .*got zfall.*Round"),
        ({"measures": ["nowhere.Effort"]}, "battery.measures .*got nowhere.Effort"),
        ({"measures": "zfall.evaluation.effort.Effort"}, "measures must be a list"),
        ({"slope": 0.1}, "options of battery planar .*got slope"),
        ({"max_tilt": "low"}, "max_tilt .*got low"),
        ({"mass_factor": [0.8]}, r"mass_factor .*got \[0.8\]"),
        ({"forces": [20, 0]}, r"forces .*got \[20, 0\]"),
        ({"resolution": 0.1}, "resolution must be null.*Planar.*got 0.1"),
        ({"interval": 3.0}, "interval must be null.*got 3.0"),
        ({"forces": [[20, 0]]}, "forces must be null"),
    ],
)
def test_tables_that_make_no_battery_are_refused(change, message):
    table = OmegaConf.to_container(table_of("planar"))
    with pytest.raises(ValueError, match=message):
        battery_of(table | change)


def test_a_number_that_is_missing_is_named():
    table = OmegaConf.to_container(table_of("planar"))
    table.pop("aftermath")
    with pytest.raises(ValueError, match="planar must have aftermath"):
        battery_of(table)


@pytest.mark.parametrize(
    ("battery", "options", "message"),
    [
        ("envelope", {"resolution": 3.0}, "resolution must lie between"),
        ("envelope", {"interval": 1.0}, "interval must be null"),
        ("spherical", {"interval": None}, "interval must be positive, got None"),
        ("spherical", {"resolution": 0.1}, "resolution must be null"),
    ],
)
def test_numbers_that_a_kind_does_not_read_are_refused(battery, options, message):
    with pytest.raises(ValueError, match=message):
        load_battery(battery, **options)
