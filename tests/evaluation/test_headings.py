"""What stands over a figure follows from the battery, the robot and the policy's env."""

from dataclasses import replace

import pandas as pd
import pytest
from omegaconf import OmegaConf

from zfall.configs import compose_config
from zfall.envs.tables import with_servos
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.headings import count, heading, servos_of, surroundings, unit
from zfall.evaluation.results import Result, _told_apart
from zfall.robots import ZEROTH01


@pytest.fixture(scope="module")
def published():
    """The config of an env with the published servos."""
    return compose_config(["env=push_recovery", "servo=published"]).env


def test_a_heading_says_policy_battery_world_number_and_unit(published):
    """m sqrt(g h0) in 0.1 s: 49 N."""
    battery = load_battery("planar", starts=3)
    where = surroundings(published, battery)
    first, second = heading("mine", battery, ZEROTH01, where, "3 per cell").split("\n")
    assert first == "mine: battery planar, pushes at the torso"
    force = ZEROTH01.mass * (9.81 * ZEROTH01.com_height) ** 0.5 / 0.1
    assert force == pytest.approx(49, abs=0.5)
    assert second == ("published servos, nominal world; 3 per cell; I = 1 is 49 N for 0.1 s")


def test_servos_are_called_by_where_their_numbers_are_from(published):
    sheets = with_servos(published, "datasheet")
    assert servos_of(sheets) == "sheets' servos"
    OmegaConf.set_struct(sheets, False)
    sheets.base_env.servos.left_knee_pitch.friction = 0.2
    assert servos_of(sheets) == "servos of its own"
    other = published.copy()
    OmegaConf.set_struct(other, False)
    other.base_env.robot = {"_target_": "zfall.robots.Robot", "name": "mine", "mjcf": "mine.xml"}
    assert servos_of(other) == "motors of its MJCF"


def test_a_battery_with_a_world_has_the_servos_of_this_world(published):
    assert surroundings(published, load_battery("twin")) == (
        "sheets' servos with losses, the battery's own world"
    )


def test_what_a_battery_changes_of_the_physics_is_said(published):
    slippery = load_battery("planar_slippery")
    said = surroundings(published, slippery, ["noise", "delay"])
    assert said == "published servos, nominal world, with noise and delay, foot friction 0.2"


def test_the_unit_is_a_force_only_where_there_is_one_duration_and_no_ball():
    planar = load_battery("planar", duration=0.2)
    assert unit(planar, ZEROTH01) == "I = 1 is 25 N for 0.2 s"
    for name in ("spherical", "icub_ball"):
        assert unit(load_battery(name), ZEROTH01) == "I = 1 is 4.9 N s"
    assert "balls at the pelvis" in heading("mine", load_battery("icub_ball"), ZEROTH01)


def test_trials_are_counted_in_each_cell_without_the_control_arm():
    rows = pd.DataFrame({"direction_rad": [0.0, 0.0, 1.0, 0.0], "impulse": [0.1, 0.1, 0.1, 0.0]})
    assert count(rows, ("direction_rad", "impulse"), "per cell") == "1 to 2 per cell"
    assert count(rows, (), "pushed trials") == "3 pushed trials"
    one = rows.iloc[2:3]
    assert count(one, ("direction_rad", "impulse"), "trials per cell") == "1 trial per cell"


def test_compared_policies_say_their_servos_where_these_differ():
    battery = load_battery("planar")
    one = Result(battery, "a", ZEROTH01, pd.DataFrame(), {}, surroundings="x servos, calm")
    same = _told_apart({"a": one, "b": one})
    assert list(same) == ["a", "b"]
    assert "\nx servos, calm; 3 per cell; I = 1 is" in same["a"].heading("3 per cell")
    apart = _told_apart({"a": one, "b": replace(one, surroundings="y servos, calm")})
    assert list(apart) == ["a (x servos)", "b (y servos)"]
    assert "\ncalm; 3 per cell; I = 1 is" in apart["a (x servos)"].heading("3 per cell")
