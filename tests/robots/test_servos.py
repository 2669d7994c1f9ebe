"""Servos against their makers' sheets, and what is refused."""

import math
from dataclasses import replace

import pytest

from zfall.robots.servos import SERVOS, STS3215, STS3250, XL330_M288, Overload, Servo, servo

EVERY = pytest.mark.parametrize("one", SERVOS.values(), ids=SERVOS)


@pytest.mark.parametrize(("one", "torque", "speed", "damping"), [
    (STS3250, 4.903, 7.874, 0.6227),  # 50 kg cm; 0.133 s for 60 degrees
    (STS3215, 2.942, 4.712, 0.6243),  # 30 kg cm; 45 rpm
    (XL330_M288, 0.52, 10.786, 0.0482),  # 0.52 N m; 103 rpm
])  # fmt: skip
def test_figures_are_those_of_the_sheets(one, torque, speed, damping):
    assert one.stall_torque == pytest.approx(torque, abs=6e-4)
    assert one.no_load_speed == pytest.approx(speed, abs=6e-4)
    assert one.damping == pytest.approx(damping, abs=6e-5)


@pytest.mark.parametrize(("kp", "stiffness"), [(22, 18.1), (32, 26.3)])
def test_stiffness_follows_the_register(kp, stiffness):
    """Duty per radian, identified by others, times the sheet's stall torque."""
    assert servo("STS3250", kp=kp).stiffness() == pytest.approx(stiffness, abs=0.06)
    at_11 = servo("STS3250", kp=kp).stiffness(11.1)
    assert at_11 == pytest.approx(stiffness * 11.1 / 12, rel=3e-3)


@EVERY
def test_the_shaft_follows_the_sheet_s_line_with_the_friction_in_it(one):
    assert one.shaft_torque(0.0) == pytest.approx(one.stall_torque)
    assert one.shaft_torque(0.5 * one.no_load_speed) == pytest.approx(0.5 * one.stall_torque)
    assert one.free_speed() == pytest.approx(one.no_load_speed)
    assert one.motor_torque() == pytest.approx(one.stall_torque + one.friction)


def test_a_lower_voltage_takes_from_the_torque_and_not_from_the_back_emf():
    """11.1 of 12 V: the motor gives 0.925 of its torque, the friction stays."""
    motor = 0.925 * (STS3250.stall_torque + STS3250.friction)
    stall = motor - STS3250.friction
    assert STS3250.motor_torque(11.1) == pytest.approx(motor)
    assert STS3250.shaft_torque(0.0, 11.1) == pytest.approx(stall)
    assert STS3250.free_speed(11.1) == pytest.approx(stall / STS3250.damping)


def test_a_sheet_of_two_voltages_agrees_with_the_law():
    """XL330 at 6 V: 123 rpm and 0.60 N m by its sheet, where the current begins to be limited."""
    assert XL330_M288.free_speed(6.0) == pytest.approx(123 * math.tau / 60, rel=0.02)
    assert XL330_M288.shaft_torque(0.0, 6.0) == pytest.approx(0.60, rel=0.06)


@pytest.mark.parametrize(("register", "acceleration"), [(0, math.inf), (1, 0.1534), (254, 38.96)])
def test_ramp_follows_the_register_and_zero_is_none(register, acceleration):
    ramp = servo("STS3215", acceleration=register).max_acceleration
    assert ramp == pytest.approx(acceleration, rel=1e-3)


@pytest.mark.parametrize(("motor", "external", "speed", "expected"), [
    (0.0, 0.0, 0.0, 0.0524),
    (2.0, 0.0, 1.0, 0.0524 + 0.045 * 2.0),
    (2.0, -1.0, 1.0, 0.0524 + 0.244 + 0.045 * 2.0),  # lifting a load: both add
    (0.5, 1.0, 1.0, 0.0524 + 0.244 - 0.045 * 0.5),  # both in one sense
    (0.0, -1.0, 0.0, 0.0524 + 0.244 + 0.142),  # at rest
    (0.0, -1.0, 0.371, 0.0524 + 0.244 + 0.142 / math.e),
])  # fmt: skip
def test_gear_friction_grows_with_the_load_on_both_sides(motor, external, speed, expected):
    assert STS3215.gear_friction(motor, external, speed) == pytest.approx(expected, rel=1e-9)


def test_encoder_and_play_are_angles():
    assert STS3250.resolution == pytest.approx(math.radians(360 / 4096))
    assert math.degrees(STS3215.backlash) == pytest.approx(1.0)
    assert STS3250.overload == Overload(share=0.8, seconds=2.0, remaining=0.2)


def test_a_winding_warms_toward_its_loss_times_the_resistance():
    """Half the motor's torque: a quarter of 12 V x 2.7 A, 8.1 W; one time constant gives 63 %."""
    warm = servo("STS3215", thermal_resistance=5.0, thermal_time_constant=300.0)
    half = 0.5 * warm.motor_torque()
    assert warm.copper_loss(half) == pytest.approx(8.1)
    rise = warm.temperature(half, 300.0, ambient=20.0) - 20.0
    assert rise == pytest.approx(5.0 * 8.1 * (1 - 1 / math.e))
    assert warm.temperature(half, 1e6) == pytest.approx(25.0 + 40.5)


@pytest.mark.parametrize(("changes", "key", "value"), [
    ({"kp": 255}, "kp of the servo STS3250", "255"),
    ({"kp": -1}, "kp of the servo STS3250", "-1"),
    ({"kp": 0}, "kp of the servo STS3250", "0"),
    ({"kp": 2.5}, "kp of the servo STS3250", "2.5"),
    ({"kp": True}, "kp of the servo STS3250", "True"),
    ({"acceleration": 300}, "acceleration of", "300"),
    ({"voltage": 13.0}, "voltage of", "13"),
    ({"voltage_range": 12.0}, "voltage_range of", "12"),
    ({"voltage_range": [12.6, 6.0]}, "voltage_range of", "12.6"),
    ({"stall_torque": 0.0}, "stall_torque of", "0"),
    ({"friction": -0.1}, "friction of", "-0.1"),
    ({"friction": math.nan}, "friction of", "nan"),
    ({"friction": "much"}, "friction of", "much"),
    ({"viscous_friction": 0.7}, "viscous_friction of", "0.7"),
    ({"overload": 0.8}, "overload of", "0.8"),
])  # fmt: skip
def test_values_that_no_servo_has_are_refused_by_name(changes, key, value):
    with pytest.raises(ValueError, match=rf"{key}.* must .*{value}"):
        servo("STS3250", **changes)


def test_unknown_servos_and_values_are_refused_with_those_there_are():
    with pytest.raises(ValueError, match="name must be one of STS3250, STS3215, .* got 'STS9'"):
        servo("STS9")
    with pytest.raises(ValueError, match="frictoin must be a value of Servo: friction"):
        servo("STS3250", frictoin=0.1)


@pytest.mark.parametrize(("ask", "key"), [
    (lambda one: one.temperature(1.0, 60.0), "thermal_time_constant"),
    (lambda one: replace(one, stall_current=None).copper_loss(1.0), "stall_current"),
    (lambda one: replace(one, friction=None).motor_torque(), "friction"),
    (lambda one: replace(one, external_load_friction=None).gear_friction(1, 1, 0), "external_load"),
])  # fmt: skip
def test_a_value_that_nobody_published_is_asked_for_by_name(ask, key):
    with pytest.raises(ValueError, match=rf"{key}.* of the servo STS3250 must be a number.*None"):
        ask(STS3250)


@pytest.mark.parametrize("voltage", [5.9, 12.7, math.nan])
def test_a_voltage_outside_of_the_sheet_is_refused(voltage):
    with pytest.raises(ValueError, match=r"voltage of the servo STS3250 must .*\[6, 12.6\] V"):
        STS3250.stiffness(voltage)


def test_a_servo_of_one_s_own_needs_its_sheet_alone():
    mine = Servo(
        name="mine", voltage=7.4, voltage_range=(6.0, 8.4), stall_torque=2.0, no_load_speed=5.0,
        kp=10, kp_range=(0, 100), kp_factory=10, duty_per_radian=0.2, encoder_steps=1024,
        acceleration_range=(0, 0), acceleration_step=0.0,
    )  # fmt: skip
    assert mine.stiffness() == pytest.approx(4.0)
    assert mine.damping == pytest.approx(0.4)
