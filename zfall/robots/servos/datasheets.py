"""Servos of two makers, each number with its source."""

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from difflib import get_close_matches
from typing import Any

from zfall.robots.servos.servo import Overload, Servo

# Friction of the gears, identified on the 7.4 V servo with the same 1:345 gears (BAM, models M1
# and M6 of the STS3215): Duclusaud and Passault, arXiv 2410.08650. They publish none of a
# 12 V servo of this family any more. What follows is scaled from it, see each servo.
_STS_LOAD_FRICTION: dict[str, Any] = {
    "motor_load_friction": 0.045,
    "external_load_friction": 0.244,
    "stribeck_load_friction": 0.142,
    "stribeck_speed": 0.371,
    "stribeck_exponent": 9.93,
}
_STS_FIRMWARE: dict[str, Any] = {
    "kp_range": (0, 254),  # one byte, register 0x15
    "kp_factory": 32,
    "encoder_steps": 4096,
    "max_temperature": 70.0,  # sheets
    "overload": Overload(share=0.8, seconds=2.0, remaining=0.2),  # registers as they are sold
    "acceleration_range": (0, 254),  # one byte, register 0x29, in 100 steps/s2
    "acceleration_step": 100 * math.tau / 4096,
    "acceleration_ceiling": (10.0, 28.0),  # measured in public tests, register 0x55 as it is sold
}

STS3250 = Servo(
    name="STS3250",
    voltage=12.0,  # sheet, Feetech edition A/0 of 2024, like the four that follow
    voltage_range=(6.0, 12.6),
    stall_torque=50 * 0.0980665,  # 50 kg cm
    no_load_speed=math.tau / 6 / 0.133,  # 0.133 s for 60 degrees
    stall_current=5.37,  # assumed: that of its motor before the gears, by its line
    backlash=math.radians(0.7),  # public test; the sheet says at most 0.5 degrees
    kp=32,
    duty_per_radian=0.16293639 / 0.97,  # published identification: error gain over largest duty
    friction=0.0524 * 50 / 30,  # scaled from the STS3215 by the sheets' torques: assumed
    viscous_friction=0.0591 * 50 / 30,  # likewise
    armature=0.0284,  # that of the STS3215: assumed, as the coreless rotor's is not published
    continuous_torque=1.25,  # public test
    **_STS_LOAD_FRICTION,
    **_STS_FIRMWARE,
)

STS3215 = Servo(
    name="STS3215",  # C018, 12 V
    voltage=12.0,  # sheet, Feetech, like the three that follow
    voltage_range=(4.0, 14.0),
    stall_torque=30 * 0.0980665,  # 30 kg cm
    no_load_speed=45 * math.tau / 60,  # 45 rpm; a public test found 46
    stall_current=2.7,  # sheet
    backlash=math.radians(1.0),  # public tests found 0.87 and 1.0; the sheet says at most 0.5
    kp=32,
    duty_per_radian=0.16292703 / 0.9964,  # published identification, as above
    friction=0.0524,  # BAM, M1, of the 7.4 V servo: the gears are the same
    viscous_friction=0.0591,  # likewise
    armature=0.0284,  # likewise
    continuous_torque=None,  # a public test held 1.5 N m at 48 degrees Celsius for an hour
    **_STS_LOAD_FRICTION,
    **_STS_FIRMWARE,
)

XL330_M288 = Servo(
    name="XL330-M288",
    voltage=5.0,  # sheet, Robotis e-manual, like the five that follow
    voltage_range=(3.7, 6.0),
    stall_torque=0.52,
    no_load_speed=103 * math.tau / 60,  # 103 rpm
    stall_current=1.47,
    encoder_steps=4096,
    kp=400,
    kp_range=(0, 16383),
    kp_factory=400,
    duty_per_radian=4096 / math.tau / 128 / 885,  # sheet: P gain / 128, in 885ths, of pulses
    friction=0.0182,  # BAM, M1, like the two that follow
    viscous_friction=0.0059,
    armature=0.00199,
    motor_load_friction=0.231,  # BAM, M6, like the four that follow
    external_load_friction=0.261,
    stribeck_load_friction=0.152,
    stribeck_speed=0.115,
    stribeck_exponent=1.0,
    max_temperature=70.0,  # sheet
    acceleration_range=(0, 32767),  # sheet: profile acceleration, in 214.577 rpm/min
    acceleration_step=214.577 * math.tau / 3600,
)

SERVOS: Mapping[str, Servo] = {each.name: each for each in (STS3250, STS3215, XL330_M288)}


def servo(name: str, **changes: Any) -> Servo:
    """A servo of ``SERVOS`` with some of its values replaced, as yaml writes it.

    Args:
        name: of the servo.
        changes: other values of ``Servo``, ``kp=22`` for instance.

    Raises:
        ValueError: on an unknown name or value, or one that is not possible.
    """
    if name not in SERVOS:
        raise ValueError(f"name must be one of {', '.join(SERVOS)}, got {name!r}.")
    known = [field.name for field in fields(Servo)]
    for key in changes:
        if key not in known:
            near = get_close_matches(key, known, n=1) or known
            raise ValueError(f"{key} must be a value of Servo: {', '.join(near)}.")
    return replace(SERVOS[name], **changes)
