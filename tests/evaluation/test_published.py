"""Published pushes against sums by hand."""

import math

import numpy as np
import pytest

from recipes.systems.pushes import PUSHES, published
from zfall.evaluation.pendulum import stand_support
from zfall.evaluation.published import Jump, jumps_table, published_table, robots_table
from zfall.robots import ZEROTH01


@pytest.fixture(scope="module")
def table():
    return published_table(ZEROTH01, published()).set_index(["system", "push"])


def test_icubs_training_push_is_half_a_unit_and_lasts_two_thirds_as_long_here(table):
    """200 N x 0.2 s over 33 kg x sqrt(9.81 x 0.53) m/s; time by the root of 0.22 / 0.53."""
    push = table.loc[("iCub", "training (IV-D)")]
    assert push["impulse"] == pytest.approx(40 / (33 * math.sqrt(9.81 * 0.53)), rel=1e-3)
    assert push["duration_s"] == pytest.approx(0.2 * math.sqrt(0.22 / 0.53), rel=5e-3)
    newton_seconds = push["force_n"] * push["duration_s"]
    assert newton_seconds == pytest.approx(push["impulse"] * ZEROTH01.impulse_unit)
    phase = math.sqrt(9.81 / 0.22) * push["duration_s"]
    factor = phase / (1 - math.exp(-phase))
    assert push["sudden"] == pytest.approx(push["impulse"] / factor, rel=5e-3)


def test_a_bell_has_less_impulse_than_its_peak_and_keeps_its_peak_ratio(table):
    """Mean of a Gaussian over three deviations to each side: 0.417 of its peak."""
    push = table.loc[("Atalante", "training (IV-A.4)")]
    unit = 135 * math.sqrt(9.81 * 0.95)
    assert push["impulse"] == pytest.approx(0.4167 * 320 / unit, rel=2e-3)
    assert push["force_n"] == pytest.approx(20.0, rel=0.02)  # of recipes/push/atalante.yaml
    assert push["of_no_step_sideways"] < 1.0


def test_pushes_of_the_same_robot_stay_what_they_are(table):
    for force, stage in ((20, "easy"), (40, "medium"), (60, "hard"), (100, "kneel trigger")):
        push = table.loc[("Zeroth-01", f"stage {stage} (3)")]
        assert push["force_n"] == pytest.approx(force, rel=5e-3)
        assert push["duration_s"] == pytest.approx(0.1, rel=5e-3)


def test_larger_pushes_of_a_system_are_larger_by_all_figures(table):
    assert len(table) == len(PUSHES)
    for name in ("impulse", "sudden", "force_n", "of_no_step_forward", "of_no_step_sideways"):
        for system in ("iCub", "Zeroth-01"):
            assert table.loc[system][name].is_monotonic_increasing


def test_a_jump_of_velocity_is_its_speed_in_units_of_the_robots_own():
    """2 m/s of a robot whose center of mass is 0.22 m high: 2 / sqrt(9.81 x 0.22)."""
    jump = Jump(system="a simulator", robot=ZEROTH01.name, speed=2.0, interval=(5.0, 10.0))
    row = jumps_table([ZEROTH01], [jump]).iloc[0]
    assert row["impulse"] == pytest.approx(2 / math.sqrt(9.81 * 0.22), rel=2e-3)
    edge = np.abs(stand_support(ZEROTH01)[:, 1]).max()  # of the soles, to the side
    assert row["of_no_step_sideways"] == pytest.approx(row["impulse"] / (edge / 0.22), rel=0.02)


def test_a_robots_pushes_last_as_long_in_units_of_its_own_time():
    row = robots_table([ZEROTH01]).iloc[0]
    assert row["impulse_unit"] == pytest.approx(3.349 * math.sqrt(9.81 * 0.22), rel=5e-3)
    assert row["time_unit"] == pytest.approx(math.sqrt(0.22 / 9.81), rel=5e-3)
    assert row["force_n"] == pytest.approx(0.1 * row["impulse_unit"] / 0.1)  # it is the first
