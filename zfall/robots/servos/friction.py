"""Dry friction of gears under load, of one servo or of arrays of them."""

from typing import Any

import numpy as np


def gear_friction(
    motor_torque: Any,
    external_torque: Any,
    speed: Any,
    *,
    motor_load_friction: Any,
    external_load_friction: Any,
    stribeck_load_friction: Any,
    stribeck_speed: Any,
    stribeck_exponent: Any,
) -> Any:
    """What load adds to the constant dry friction [N m].

    With the shares m and e of the motor's torque M and of the torque E from outside, both
    positive in the same sense, and s of the latter at rest::

        |e E - m M| + s |E| exp(-|speed / stribeck_speed| ** stribeck_exponent)

    All arguments are numbers, or arrays that NumPy broadcasts: ``(N, J)``, and ``(J,)`` of the
    constants.

    Args:
        motor_torque: of the motor, back-EMF included [N m].
        external_torque: from outside, at the shaft [N m].
        speed: of the shaft [rad/s].
        motor_load_friction, external_load_friction, stribeck_load_friction: m, e and s (1).
        stribeck_speed: [rad/s].
        stribeck_exponent: (1).

    Source: Duclusaud and Passault, "Extended friction models for the physics simulation of servo
    actuators", arXiv 2410.08650, model M6 without its quadratic terms.
    """
    away = np.abs(np.divide(speed, stribeck_speed)) ** stribeck_exponent
    at_rest = stribeck_load_friction * np.abs(external_torque) * np.exp(-away)
    lost = external_load_friction * external_torque - motor_load_friction * motor_torque
    return np.abs(lost) + at_rest
