"""The walking battery, put to a robot that stands."""

import math

import pytest

from zfall.evaluation.battery import run_battery
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.kinds import kind_of

COMMANDS = [[0.0, 0.0, 0.0], [0.2, 0.1, 0.4]]


@pytest.fixture(scope="module")
def walking():
    return load_battery("walking", commands=COMMANDS, starts=2, push_time=0.5, end_time=2.0)


@pytest.fixture(scope="module")
def stood(walking, compose_config):
    return run_battery(walking, compose_config("env=zeroth_walk").env, None, num_envs=64)


def test_who_stands_still_misses_a_command_by_all_of_it(stood):
    """For 2 s at 0.4 rad/s a heading of 0.8 rad, but for what the start noise turns it by."""
    told = stood[stood["command_vx"] > 0]
    assert len(told) == 2
    assert not stood["fell"].any()
    assert told["velocity_error"].tolist() == pytest.approx([math.hypot(0.2, 0.1)] * 2, abs=0.02)
    assert told["yaw_rate_error"].tolist() == pytest.approx([0.4] * 2, abs=0.03)
    assert told["heading_error"].tolist() == pytest.approx([0.8] * 2, abs=0.1)
    untold = stood[stood["command_vx"] == 0]
    assert untold[["velocity_error", "yaw_rate_error"]].max().max() < 0.03
    assert untold["heading_error"].max() < 0.1


def test_a_summary_has_a_row_for_each_command_and_counts_falls(walking, stood):
    fallen = stood.assign(fell=[False, False, True, False])
    summary = kind_of(walking).summary(walking, fallen)
    assert (summary["control_falls"], summary["control_n"]) == (1, 4)
    first, second = summary["commands"]
    assert (first["trials"], first["fell"], second["fell"]) == (2, 0, 1)
    assert second["command_yaw"] == 0.4
    assert summary["heading_error"] == pytest.approx(fallen["heading_error"].mean())


def test_who_is_given_no_commands_cannot_be_tested(walking, compose_config):
    with pytest.raises(ValueError, match="run must be a policy that is given commands"):
        run_battery(walking, compose_config().env, None, num_envs=64)


def test_a_walking_battery_without_commands_is_refused():
    with pytest.raises(ValueError, match=r"battery\.commands must hold at least one"):
        load_battery("walking", commands=[])
