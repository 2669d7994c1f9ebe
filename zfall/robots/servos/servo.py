"""A servo: its datasheet, and the constants of the physics that follow from it."""

import math
from dataclasses import dataclass, fields, replace
from typing import Any, NoReturn

from zfall.robots.servos.friction import gear_friction

LOAD_FRICTION = (  # the constants of ``gear_friction``
    *("motor_load_friction", "external_load_friction", "stribeck_load_friction"),
    *("stribeck_speed", "stribeck_exponent"),
)
_POSITIVE = ("voltage", "stall_torque", "no_load_speed", "kp", "duty_per_radian", "encoder_steps")


@dataclass(frozen=True, kw_only=True)
class Overload:
    """A firmware's answer to overload: after some time above a torque it gives less.

    Args:
        share: of the largest torque, above which the time runs (1).
        seconds: after which the servo gives way [s].
        remaining: share of the largest torque that it then gives (1).
    """

    share: float
    seconds: float
    remaining: float


@dataclass(frozen=True, kw_only=True)
class Servo:
    """A position servo with a DC motor, gears and firmware, at its output shaft.

    ``None`` says that no number is published: what needs it refuses. At the voltage V the joint
    feels::

        torque = clip(stiffness(V) error, +-motor_torque(V)) - damping speed - friction sign(speed)

    The clip is reached a little beyond an error of ``1 / (kp duty_per_radian)``, at which the
    firmware's duty is full: ``stiffness`` goes by the torque of the sheet, without the friction.

    A sheet's figures are measured at the shaft, friction included: at its voltage and full duty
    this is its line, ``stall_torque`` at rest and nothing at ``no_load_speed``.

    Args:
        name: the maker's.
        voltage: at which torque and speed are given [V].
        voltage_range: in which it works [V].
        stall_torque: at the shaft [N m].
        no_load_speed: of the shaft [rad/s].
        stall_current: [A].
        kp: the firmware's register of the position loop, as it is used.
        kp_range: values that the register takes.
        kp_factory: value at which it is sold.
        duty_per_radian: duty for an error of one radian and a ``kp`` of 1 [1/rad].
        friction: constant dry friction of the gears [N m].
        viscous_friction: of the gears, the part of ``damping`` that is no back-EMF [N m s/rad].
        armature: inertia of rotor and gears at the shaft [kg m2].
        motor_load_friction: share of the motor's torque that is added to the dry friction (1).
        external_load_friction: the same, of the torque from outside (1).
        stribeck_load_friction: added to it at rest (1).
        stribeck_speed: at which that is gone [rad/s].
        stribeck_exponent: how suddenly (1).
        backlash: play of the shaft, from end to end [rad].
        encoder_steps: in a turn.
        continuous_torque: that it bears for hours [N m].
        thermal_resistance: from winding to air [K/W].
        thermal_time_constant: of the winding's temperature [s].
        max_temperature: at which the firmware switches off [degree Celsius].
        overload: the firmware's rule.
        acceleration: the firmware's register of the ramp, as it is used; 0 is no ramp.
        acceleration_range: values that the register takes.
        acceleration_step: acceleration for a register of 1 [rad/s2].
        acceleration_ceiling: ramps that were measured with the firmware's ceiling as it is sold,
            whatever the register says, slowest and fastest [rad/s2].

    Raises:
        ValueError: on a register out of its range, or a value that is not possible.
    """

    name: str
    voltage: float
    voltage_range: tuple[float, float]
    stall_torque: float
    no_load_speed: float
    kp: int
    kp_range: tuple[int, int]
    kp_factory: int
    duty_per_radian: float
    encoder_steps: int
    acceleration_range: tuple[int, int]
    acceleration_step: float
    acceleration: int = 0
    stall_current: float | None = None
    friction: float | None = None
    viscous_friction: float | None = None
    armature: float | None = None
    motor_load_friction: float | None = None
    external_load_friction: float | None = None
    stribeck_load_friction: float | None = None
    stribeck_speed: float | None = None
    stribeck_exponent: float | None = None
    backlash: float | None = None
    continuous_torque: float | None = None
    thermal_resistance: float | None = None
    thermal_time_constant: float | None = None
    max_temperature: float | None = None
    overload: Overload | None = None
    acceleration_ceiling: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.overload is not None and not isinstance(self.overload, Overload):
            self._refuse("overload", "be an Overload or null", self.overload)
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, list):  # as yaml writes them
                object.__setattr__(self, field.name, tuple(value))
            if field.name not in ("name", "overload") and value is not None:
                self._check_number(field.name, value)
        for register in ("kp", "kp_factory", "acceleration"):
            key, value = register.removesuffix("_factory"), getattr(self, register)
            low, high = getattr(self, f"{key}_range")
            if value != int(value) or not low <= value <= high:
                self._refuse(register, f"be a whole number within [{low}, {high}]", value)
        if self.viscous_friction is not None and not self.viscous_friction < self.damping:
            rule = f"be less than stall_torque / no_load_speed, {self.damping:.3g}"
            self._refuse("viscous_friction", rule, self.viscous_friction)
        self._volts(self.voltage)

    @property
    def damping(self) -> float:
        """Torque lost for each rad/s, to back-EMF and viscous friction [N m s/rad].

        ``stall_torque / no_load_speed``, whatever the voltage.
        """
        return self.stall_torque / self.no_load_speed

    @property
    def back_emf(self) -> float:
        """The part of ``damping`` that is the motor's back-EMF [N m s/rad].

        Raises:
            ValueError: if the viscous friction is not known.
        """
        return self.damping - self.need("viscous_friction")

    def motor_torque(self, voltage: float | None = None) -> float:
        """The motor's own torque at rest and full duty, in front of the friction [N m].

        Args:
            voltage: of the supply [V]; that of the sheet if ``None``.

        Raises:
            ValueError: on a voltage out of range, or if the friction is not known.
        """
        at_rest = self.stall_torque + self.need("friction")
        return at_rest * self._volts(voltage) / self.voltage

    def shaft_torque(self, speed: float, voltage: float | None = None) -> float:
        """Torque that is left at the shaft at a speed, at full duty [N m].

        Args:
            speed: not negative [rad/s].
            voltage: of the supply [V]; that of the sheet if ``None``.

        Raises:
            ValueError: on a voltage out of range, or if the friction is not known.
        """
        return self.motor_torque(voltage) - self.need("friction") - self.damping * speed

    def free_speed(self, voltage: float | None = None) -> float:
        """Speed at which no torque is left at the shaft [rad/s].

        Args:
            voltage: of the supply [V]; that of the sheet if ``None``.

        Raises:
            ValueError: on a voltage out of range, or if the friction is not known.
        """
        return self.shaft_torque(0.0, voltage) / self.damping

    def stiffness(self, voltage: float | None = None) -> float:
        """Torque for each radian of error, ``kp duty_per_radian stall_torque`` [N m/rad].

        Args:
            voltage: of the supply [V]; that of the sheet if ``None``.

        Raises:
            ValueError: on a voltage out of range.
        """
        share = self._volts(voltage) / self.voltage
        return self.kp * self.duty_per_radian * self.stall_torque * share

    @property
    def max_acceleration(self) -> float:
        """Of the firmware's ramp [rad/s2]; infinite without one."""
        return self.acceleration * self.acceleration_step or math.inf

    @property
    def resolution(self) -> float:
        """Of the encoder [rad]."""
        return math.tau / self.encoder_steps

    def gear_friction(self, motor_torque: float, external_torque: float, speed: float) -> float:
        """Largest dry friction under load, ``friction`` and what ``friction.gear_friction`` adds.

        Raises:
            ValueError: if a constant of the friction is not known.
        """
        constants = {name: self.need(name) for name in LOAD_FRICTION}
        added = gear_friction(motor_torque, external_torque, speed, **constants)
        return self.need("friction") + float(added)

    def before_gears(self) -> "Servo":
        """The servo by what its motor gives in front of the losses under load.

        Of the stall torque S at the shaft, measured after all losses, the motor's is
        ``(S (1 + e + s) + friction) / (1 - m)``, with the shares of ``gear_friction``. Where that
        acts on the shaft, this servo meets the sheet; its speed without a load stays.

        Raises:
            ValueError: if a share is not known.
        """
        kept = 1.0 + self.need("external_load_friction") + self.need("stribeck_load_friction")
        motor = self.stall_torque * kept + self.need("friction")
        motor /= 1.0 - self.need("motor_load_friction")
        return replace(self, stall_torque=motor - self.need("friction"))

    def copper_loss(self, torque: float) -> float:
        """Heat in the winding while the motor gives a torque [W].

        ``voltage stall_current (torque / motor_torque)^2``.

        Raises:
            ValueError: if the stall current or the friction is not known.
        """
        at_stall = self.voltage * self.need("stall_current")
        return at_stall * (torque / self.motor_torque()) ** 2

    def temperature(self, torque: float, seconds: float, ambient: float = 25.0) -> float:
        """Of the winding after holding a torque, from cold [degree Celsius].

        ``ambient + thermal_resistance copper_loss (1 - exp(-seconds / thermal_time_constant))``.

        Raises:
            ValueError: if a thermal constant, the stall current or the friction is not known.
        """
        warmed = 1.0 - math.exp(-seconds / self.need("thermal_time_constant"))
        return ambient + self.need("thermal_resistance") * self.copper_loss(torque) * warmed

    def need(self, name: str) -> float:
        """A value that may be unknown.

        Raises:
            ValueError: if it is.
        """
        value = getattr(self, name)
        if value is None:
            self._refuse(name, "be a number: no figure is published, give your own", value)
        return float(value)

    def _volts(self, voltage: float | None) -> float:
        volts, (low, high) = self.voltage if voltage is None else voltage, self.voltage_range
        if not low <= volts <= high:
            self._refuse("voltage", f"be within its sheet's [{low:g}, {high:g}] V", volts)
        return volts

    def _check_number(self, name: str, value: Any) -> None:
        is_range = name.endswith(("_range", "_ceiling"))
        if is_range and not (isinstance(value, tuple | list) and len(value) == 2):
            self._refuse(name, "be two numbers, [smallest, largest]", value)
        for number in value if is_range else (value,):
            if isinstance(number, bool) or not isinstance(number, int | float):
                self._refuse(name, "be a number", value)
            if not (math.isfinite(number) and number >= 0):
                self._refuse(name, "be finite and not negative", value)
        if is_range and value[0] > value[1]:
            self._refuse(name, "have the smallest number first", value)
        if name in _POSITIVE and not value > 0:
            self._refuse(name, "be positive", value)

    def _refuse(self, name: str, rule: str, value: Any) -> NoReturn:
        raise ValueError(f"{name} of the servo {self.name} must {rule}; got {value}.")
