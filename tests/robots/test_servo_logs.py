"""Logs of a servo: what is read, and what no servo can be fitted to."""

import numpy as np
import pandas as pd
import pytest

from zfall.robots.servos.logs import Load, read_log


@pytest.fixture
def table():
    """Two seconds at 100 Hz: rest, and a step that is followed at once."""
    time = 5.0 + 0.01 * np.arange(200)
    target = np.where(time < 5.5, 0.1, 0.4)
    return pd.DataFrame({"time_s": time, "target_rad": target, "position_rad": target})


def read(table, tmp_path, **options):
    table.to_csv(tmp_path / "log.csv", index=False)
    return read_log(tmp_path / "log.csv", **({"load": Load(), "voltage": 12.0} | options))


def test_a_log_begins_at_time_0_and_takes_a_voltage_that_it_lacks(table, tmp_path):
    log = read(table, tmp_path, voltage=11.5, load=Load(mass=0.5, arm=0.2))
    assert (log.time[0], log.time[-1]) == (0.0, pytest.approx(1.99))
    assert log.voltage.tolist() == [11.5] * 200
    assert log.start == pytest.approx(0.1)
    assert log.load.mass == 0.5


def test_a_log_s_own_voltage_counts_and_other_columns_do_not(table, tmp_path):
    log = read(table.assign(voltage_v=11.9, current_a="much"), tmp_path)
    assert log.voltage.tolist() == [11.9] * 200


def cut(table, rows):
    return table.drop(index=rows)


@pytest.mark.parametrize(("spoil", "message"), [
    (lambda t: cut(t, range(60, 70)), r"time_s must go on by at most 0.05 s .* gap of 0.11 s"),
    (lambda t: t.assign(position_rad=0.1), r"position_rad must move by at least 0.05 rad, got 0"),
    (lambda t: t.assign(target_rad=0.1), r"target_rad must move by at least 0.05 rad, got 0"),
    (lambda t: t.head(99), r"must have at least 100 rows, got 99"),
    (lambda t: t.assign(time_s=t.time_s.to_numpy()[::-1]), r"time_s must rise.* got 6.98 after 6.99"),
    (lambda t: t.assign(position_rad=t.position_rad.where(t.index != 7)), "position_rad must be .* row 8"),
    (lambda t: t.assign(target_rad="high"), r"target_rad must be finite, got high in row 1"),
    (lambda t: t.drop(columns="position_rad"), r"must have the columns .* lacks position_rad"),
    (lambda t: t.assign(target_rad=57.3 * t.target_rad), r"target_rad must be radians .* got 22.9"),
    (lambda t: t.assign(position_rad=0.1 + 0.1 * t.index), r"position_rad must be.* got 20"),
    (lambda t: t.assign(position_rad=0.1 + 0.01 * t.index), r"position_rad must begin at rest"),
])  # fmt: skip
def test_logs_that_no_servo_can_be_fitted_to_are_refused_in_one_line(
    spoil, message, table, tmp_path
):
    with pytest.raises(ValueError, match=rf"log.csv.*{message}") as refused:
        read(spoil(table), tmp_path)
    assert "\n" not in str(refused.value)


def test_a_log_that_is_not_there_or_empty_is_refused(tmp_path):
    options = {"load": Load(), "voltage": 12.0}
    with pytest.raises(ValueError, match="log must be a csv file .* there is no .*absent.csv"):
        read_log(tmp_path / "absent.csv", **options)
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(ValueError, match="log must be a csv file, .*empty.csv cannot be read"):
        read_log(tmp_path / "empty.csv", **options)


@pytest.mark.parametrize(("values", "message"), [
    ({"mass": -0.1}, "mass must be finite and not negative, got -0.1"),
    ({"inertia": np.inf}, "inertia must be .* got inf"),
    ({"down": np.nan}, "down must be finite, got nan"),
    ({"mass": 0.5}, "arm must be positive for a mass of 0.5 kg, got 0"),
])  # fmt: skip
def test_loads_that_cannot_be_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        Load(**values)
