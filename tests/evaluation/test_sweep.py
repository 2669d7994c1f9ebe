"""Worlds made wider, and the table of what becomes of a policy in them."""

import math

import pandas as pd
import pytest

from zfall.evaluation.definitions import load_battery
from zfall.evaluation.sweep import sweep_table, widened

WORLD = {
    "physics": {"draws": {"params": {"foot_friction": {"uniform": [0.5, 1.5], "shared": True}}}},
    "sensors": {"noise": {"_target_": "a.B", "std": {"joint_position": 0.01}}},
}


@pytest.mark.parametrize(
    ("width", "bounds", "std"),
    [
        (1.0, [0.5, 1.5], 0.01),
        (0.0, [1.0, 1.0], 0.0),
        (0.5, [0.75, 1.25], 0.005),
        (2.0, [0.02, 2.0], 0.02),  # no friction below 0.02
    ],
)
def test_a_world_is_widened_about_its_middle(width, bounds, std):
    found = widened(WORLD, width)
    params = found["physics"]["draws"]["params"]
    assert params["foot_friction"] == {"uniform": pytest.approx(bounds), "shared": True}
    assert found["sensors"]["noise"] == {"_target_": "a.B", "std": {"joint_position": std}}
    assert WORLD["sensors"]["noise"]["std"] == {"joint_position": 0.01}


def test_offsets_and_slopes_may_be_negative_and_other_distributions_are_widened_too():
    params = {
        "slope": {"uniform": [-0.03, 0.03]},
        "joint_zero_offset": {"uniform": [-0.02, 0.02]},
        "com_offset": {"normal": [0.1, 0.003]},
        "joint_armature": {"log_uniform": [0.5, 2.0]},
        "payload": {"uniform": [0.0, 0.2]},
    }
    noise = {"noise": {"uniform": {"joint_position": 0.01}}}
    found = widened({"physics": {"params": params}, "sensors": noise}, 2.0)
    assert found["sensors"]["noise"] == {"uniform": {"joint_position": 0.02}}
    found = found["physics"]["params"]
    assert found["slope"]["uniform"] == pytest.approx([-0.06, 0.06])
    assert found["joint_zero_offset"]["uniform"] == pytest.approx([-0.04, 0.04])
    assert found["com_offset"]["normal"] == pytest.approx([0.1, 0.006])
    assert found["joint_armature"]["log_uniform"] == pytest.approx([0.25, 4.0])
    assert found["payload"]["uniform"] == pytest.approx([0.0, 0.3])
    servos = {"physics": {"params": {"battery_voltage": {"uniform": [0.9, 1.0]}}}}
    (voltage,) = widened(servos, 4.0, {"battery_voltage": (0.5, 1.05)})["physics"].values()
    assert voltage["battery_voltage"]["uniform"] == pytest.approx([0.75, 1.05])
    far = widened({"physics": {"params": params}}, 100.0)["physics"]["params"]
    assert far["slope"]["uniform"] == pytest.approx([-math.pi / 4, math.pi / 4])


@pytest.mark.parametrize("name", ["zeroth_sweep", "twin"])
def test_a_width_of_1_is_the_world_as_it_is(name):
    world = load_battery(name).world
    assert load_battery(name, world=widened(world, 1.0)).world == world


@pytest.mark.parametrize("width", [0.0, 1.0, 2.0])
def test_the_battery_of_the_sweep_is_one_at_every_width(width):
    world = load_battery("zeroth_sweep").world
    assert load_battery("zeroth_sweep", world=widened(world, width)).world is not None


def test_a_row_of_the_sweep_counts_recoveries_and_falls():
    """Two directions, two sizes: of 0.2 three of four are recovered, of 0.4 one; I50 0.4 and 0.2."""
    battery = load_battery("planar", impulses=[0.2, 0.4], starts=2, directions=2)
    rows = [(0.0, 0.0, True), (3.14, 0.0, False)]
    rows += [(0.0, 0.2, True), (0.0, 0.2, True), (3.14, 0.2, True), (3.14, 0.2, False)]
    rows += [(0.0, 0.4, True), (0.0, 0.4, False), (3.14, 0.4, False), (3.14, 0.4, False)]
    trials = pd.DataFrame(rows, columns=["direction_rad", "impulse", "recovered"])
    trials = trials.assign(fell=~trials["recovered"], seed=0, target_smoothness=0.0, force_n=1.0)
    (row,) = sweep_table(battery, {0.5: trials}).to_dict("records")
    assert row == {
        "width": 0.5, "I = 0.2": 0.75, "I = 0.4": 0.25, "i50_mean": pytest.approx(0.3),
        "falls": 1, "control": 2, "pushed": 4,
    }  # fmt: skip
