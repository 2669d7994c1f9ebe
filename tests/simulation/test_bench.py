"""A servo on a bench against the law of its page, integrated by SciPy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from zfall.robots.servos import STS3215, STS3250
from zfall.robots.servos.logs import Load, ServoLog
from zfall.simulation.bench import LateServo, run_bench

SMOOTH = replace(STS3250, friction=0.0, backlash=0.0, voltage=12.0)
GRAVITY = 9.81


def steps(load, *, volts=12.0, level=1.0, seconds=1.0):
    """A log at 100 Hz of a step after 0.1 s; its position is not read."""
    time = 0.01 * np.arange(round(100 * seconds))
    target = np.where(time < 0.095, 0.0, level)
    voltage = np.broadcast_to(volts, time.shape)
    zeros = np.zeros_like(time)
    return ServoLog(
        name="steps", time=time, target=target, position=zeros, voltage=voltage, load=load
    )


@pytest.mark.parametrize("load", [Load(), Load(inertia=0.02), Load(mass=1.0, arm=0.15, down=0.0)])
@pytest.mark.parametrize("volts", [12.0, 11.1])
def test_a_step_is_that_of_the_law(load, volts):
    """``M a = clip(k e, +-T) - d v - m g l sin q``, through the clip and back, late by 12.3 ms."""
    latency, share = 0.0123, volts / 12.0
    inertia = SMOOTH.armature + load.inertia + load.mass * load.arm**2
    most = share * SMOOTH.stall_torque

    def law(time, state):
        target = 1.0 if time >= 0.1 + latency else 0.0
        torque = np.clip(share * SMOOTH.stiffness() * (target - state[0]), -most, most)
        fall = GRAVITY * load.mass * load.arm * math.sin(state[0] - load.down)
        return [state[1], (torque - SMOOTH.damping * state[1] - fall) / inertia]

    log = steps(load, volts=volts)
    options = {"t_eval": log.time, "max_step": 2e-4, "rtol": 1e-9, "atol": 1e-11}
    expected = solve_ivp(law, (0.0, 1.0), [0.0, 0.0], **options).y[0]
    (ours,) = run_bench([LateServo(servo=SMOOTH, latency=latency)], log, physics_dt=0.002)
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(ours, expected, atol=2e-4)


def test_a_sagging_supply_takes_from_the_torque_while_it_sags():
    """Twice the voltage of the log: before the change as with one, at the end as with the other."""
    log = steps(Load(mass=1.0, arm=0.15), seconds=2.0)
    low = replace(log, voltage=np.full_like(log.time, 9.0))
    both = replace(log, voltage=np.where(log.time < 1.0, 12.0, 9.0))
    unit = [LateServo(servo=SMOOTH, latency=0.0)]
    (x,), (y,), (z,) = (run_bench(unit, each, physics_dt=0.002) for each in (log, low, both))
    np.testing.assert_array_equal(z[:100], x[:100])
    assert z[-1] == pytest.approx(y[-1], abs=1e-4)
    assert x[-1] - y[-1] > 0.005  # it hangs lower


def test_a_pendulum_sags_by_gravity_over_stiffness():
    """Held at 90 degrees from straight down."""
    load = Load(mass=0.5, arm=0.2, down=0.6 - math.pi / 2)
    log = steps(load, level=0.6, seconds=3.0)
    (x,) = run_bench([LateServo(servo=SMOOTH, latency=0.0)], log, physics_dt=0.002)
    sag = GRAVITY * 0.5 * 0.2 * math.cos(0.6 - x[-1]) / SMOOTH.stiffness()
    assert 0.6 - x[-1] == pytest.approx(sag, rel=1e-4)


def test_play_leaves_half_of_it_on_either_side():
    loose = LateServo(servo=replace(SMOOTH, backlash=0.04), latency=0.0)
    for level in (0.5, -0.5):
        (x,) = run_bench([loose], steps(Load(), level=level, seconds=2.0), physics_dt=0.002)
        assert level - x[-1] == pytest.approx(math.copysign(0.02, level), abs=1e-6)


@pytest.mark.parametrize("volts", [12.0, 9.0])
def test_what_rests_in_its_play_stays_where_the_log_begins(volts):
    """Half a newton metre hangs on it: at any voltage the play rests where its torque holds that."""
    load = Load(mass=0.5, arm=0.1, down=-math.pi / 2)
    loose = LateServo(servo=replace(SMOOTH, backlash=0.5), latency=0.0)
    (x,) = run_bench([loose], steps(load, volts=volts, level=0.0), physics_dt=0.002)
    np.testing.assert_allclose(x, 0.0, atol=1e-4)


def test_each_servo_moves_as_it_does_alone():
    units = [LateServo(servo=one, latency=0.01) for one in (STS3250, STS3215)]
    together = run_bench(units, steps(Load()), physics_dt=0.002)
    alone = [run_bench([unit], steps(Load()), physics_dt=0.002)[0] for unit in units]
    np.testing.assert_array_equal(together, np.stack(alone))
