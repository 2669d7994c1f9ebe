"""Values of a servo, found again in logs that the simulation made with it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.servo_logs import drawn_servo, simulated_log
from zfall.robots.servos import STS3250
from zfall.simulation.bench import run_bench
from zfall.simulation.identification import NAMES, identify


def covered(found, unit) -> dict[str, bool]:
    """Whether the interval of each value has the true one."""
    true = {name: getattr(unit.servo, name) for name in NAMES if name != "latency"}
    true["latency"] = unit.latency
    return {each.name: each.low <= true[each.name] <= each.high for each in found.estimates}


def test_a_pendulum_s_log_determines_every_value():
    """All within a few percent of the truth, in narrow intervals, and the log within its noise."""
    unit = drawn_servo(1000)
    log = simulated_log(unit, "pendulum", 1000)
    found = identify([log], STS3250)
    assert all(each.determined and not each.given for each in found.estimates)
    assert sum(covered(found, unit).values()) >= 6  # one in twenty may lie outside
    close = {"stall_torque": 0.01, "no_load_speed": 0.01, "duty_per_radian": 0.01}
    for each in found.estimates:
        true = unit.latency if each.name == "latency" else getattr(unit.servo, each.name)
        assert each.value == pytest.approx(true, rel=close.get(each.name, 0.1))
    (rms,) = found.rms([log])
    assert rms == pytest.approx(STS3250.resolution / np.sqrt(12), rel=0.25)


def test_without_a_load_torques_are_known_as_shares_of_the_stall_torque_alone():
    """Twice all torques and inertias move the same: the sheet's stall torque stays, and says so."""
    unit = drawn_servo(1)
    found = identify([simulated_log(unit, "steps", 1)], STS3250)
    by_name = {each.name: each for each in found.estimates}
    stall = by_name["stall_torque"]
    assert not stall.determined
    assert stall.value == STS3250.stall_torque
    assert stall.high > 2 * stall.value
    assert "not determined" in stall.verdict
    for name in ("armature", "friction"):
        assert by_name[name].given == ("stall_torque",)
    true = unit.servo.armature / unit.servo.stall_torque
    assert by_name["armature"].value / stall.value == pytest.approx(true, rel=0.01)
    for name in ("no_load_speed", "duty_per_radian", "latency"):
        assert by_name[name].determined
        assert not by_name[name].given
        assert covered(found, unit)[name]


def test_small_motion_does_not_tell_the_torque_limit():
    """Errors below those of full duty: stiffness and damping show, neither limit nor speed does."""
    unit = drawn_servo(2)
    log = simulated_log(unit, "pendulum", 2)
    small = replace(log, target=0.05 * log.target)
    found = identify([remade(unit, small)], STS3250, physics_dt=0.004)
    by_name = {each.name: each for each in found.estimates}
    assert not by_name["stall_torque"].determined
    true = unit.servo.stiffness()
    assert found.unit.servo.stiffness() == pytest.approx(true, rel=0.1)


def remade(unit, log):
    """The log with the positions that belong to its targets, as exact as the physics."""
    return replace(log, position=run_bench([unit], log, physics_dt=0.0005)[0])


def test_a_voltage_above_the_sheet_s_is_refused_by_log():
    log = simulated_log(drawn_servo(0), "steps", 0)
    with pytest.raises(ValueError, match=r"steps: voltage of the servo STS3250 must .* got 13"):
        identify([replace(log, voltage=np.full_like(log.time, 13.0))], STS3250)


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say():
    """84 intervals of 12 servos: at least 90 %, and of each value at least 9 of 12."""
    hits = []
    for seed in range(12):
        unit = drawn_servo(seed)
        logs = [simulated_log(unit, kind, seed) for kind in ("steps", "chirp", "pendulum")]
        found = identify(logs, STS3250)
        assert all(each.determined for each in found.estimates)
        hits.append([*covered(found, unit).values()])
    print(dict(zip(NAMES, np.sum(hits, axis=0).tolist(), strict=True)))
    assert np.mean(hits) >= 0.9
    assert np.sum(hits, axis=0).min() >= 9
