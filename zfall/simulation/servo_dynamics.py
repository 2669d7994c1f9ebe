"""Effects in a servo that MuJoCo lacks: friction under load, a common supply, overload, heat.

All of it is computed once in a control step, from the step before, and acts through fields that
differ by world.
"""

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zfall.robots.servos import Servo
from zfall.robots.servos.friction import gear_friction
from zfall.robots.servos.servo import LOAD_FRICTION, Overload
from zfall.simulation.cpu import Simulation
from zfall.simulation.quantities import SERVOS, Quantity
from zfall.simulation.servo_fields import ServoFields

Array = NDArray[np.float64]

AMBIENT = 25.0  # of the air, and of a winding at the start of an episode [degree Celsius]
RELEASE = 0.99  # an overload is over when less than this of what is left is needed (1)
NO_RULE = Overload(share=math.inf, seconds=math.inf, remaining=1.0)
# What there is for an episode ``(N, J)``, or ``(N, 1)`` of the supply; all begin with 0.
STATE = ("load_friction", "conductance", "emf_current", "overload_time", "overloaded", "heating")


class ServoDynamics:
    """Servos of all worlds on one supply each.

    With the motor's torque M (back-EMF included), the duty d and the speed w of a servo, its
    current at stall I and the torque at stall M0 of its motor, at the voltage V0 of the sheet:

    - **friction**: ``Servo.gear_friction(M, E, w)``. The torque E from outside is what the mean
      motion of the step leaves: ``armature acceleration - M + viscous w`` and the dry friction,
      MuJoCo's: soft, so that a shaft at rest creeps a little, which tells how much of it acts.
    - **supply**: a winding draws ``i = I (d V / V0 - back_emf w / M0)``, the battery gives the sum
      of all ``d i``, and ``V = V_battery - R sum(d i)``, solved for the duties and speeds of the
      step: it does not oscillate. What braking servos give back feeds the others, and does not
      charge the battery. V does not fall below the least of the sheets.
    - **overload**: ``|d|`` above ``share`` for ``seconds`` lets the largest torque fall to
      ``remaining`` of itself, until the position loop needs less than that.
    - **heat**: ``dT/dt = (thermal_resistance copper_loss - (T - AMBIENT)) / thermal_time_constant``
      of the winding, if all constants are known. Nothing acts upon it.

    Args:
        model: the compiled model, with an actuator and a sensor ``joint_torque/NAME`` of each.
        joints: names of the joints J.
        servos: by joint, with what their motors give: ``Servo.before_gears``.
        values: of ``PhysicsParameters``, ``load_friction`` ``(N, J)`` and ``supply_resistance``
            ``(N, 1)`` among them; looked at in each step.
        control_dt: time between two calls of ``act`` [s].

    Raises:
        ValueError: without servos, if they have not the same voltage, or if one lacks a constant
            of its friction.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        joints: Sequence[str],
        servos: Mapping[str, Servo] | None,
        values: Mapping[str, Tensor],
        control_dt: float,
    ):
        self._values, self._dt = values, control_dt
        if servos is None:
            raise ValueError("servo_dynamics must go with servos: servo=datasheet; got none.")
        self._fields, each = ServoFields(model, joints), [servos[joint] for joint in joints]
        self._place = np.array([int(model.joint(joint).qposadr[0]) for joint in joints])
        self._speed = np.array([int(model.joint(joint).dofadr[0]) for joint in joints])
        # MuJoCo's dry friction: (acceleration + reference speed) / softness, up to its limit.
        start, end = model.dof_solimp[self._speed, :2].T
        self._softness = (1.0 - start) / start * model.dof_invweight0[self._speed]
        self._reference = 2.0 / (end * model.dof_solref[self._speed, 0])
        torques = [model.sensor(f"joint_torque/{joint}") for joint in joints]
        self._torque = torch.tensor([int(sensor.adr[0]) for sensor in torques])
        if len({one.voltage for one in each}) > 1:
            found = ", ".join(f"{one.name} {one.voltage:g} V" for one in dict.fromkeys(each))
            raise ValueError(f"servos must be of one voltage for servo_dynamics, got {found}.")
        self._voltage = each[0].voltage
        self._least = max(one.voltage_range[0] for one in each)

        def constants(name: str) -> Array:
            return np.array([one.need(name) for one in each])

        self._load = {name: constants(name) for name in LOAD_FRICTION}
        self._friction, self._viscous = constants("friction"), constants("viscous_friction")
        self._armature = constants("armature")
        self._emf = np.array([one.back_emf for one in each])
        self._stall = np.array([one.motor_torque() for one in each])
        rules = [one.overload or NO_RULE for one in each]
        self._share, self._seconds, self._remaining = (
            np.array([getattr(rule, name) for rule in rules])
            for name in ("share", "seconds", "remaining")
        )
        currents = [one.stall_current for one in each]
        self._current = None if None in currents else np.array(currents, dtype=float)
        warm = [(one.thermal_resistance, one.thermal_time_constant) for one in each]
        known = self._current is not None and all(None not in pair for pair in warm)
        self._thermal = np.array(warm, dtype=float).T if known else None  # (2, J)
        worlds = len(values["supply_resistance"])
        self._rows = torch.ones(worlds, dtype=torch.bool)
        self._state: dict[str, Array] = {
            name: np.zeros((worlds, 1 if name in ("conductance", "emf_current") else len(each)))
            for name in STATE
        }

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What ``read`` gives: the temperature only if all thermal constants are known."""
        return SERVOS if self._thermal is not None else SERVOS[:2]

    def act(self, simulation: Simulation) -> None:
        """Gives the servos of all worlds what they have in the coming control step."""
        qpos, qvel = simulation.qpos.numpy(), simulation.qvel.numpy()
        self._before = qpos[:, self._place], qvel[:, self._speed]
        self._put(simulation, self._rows)

    def advance(self, simulation: Simulation, sensors: Tensor) -> None:
        """Takes what the control step gave, its sensor values ``(N, S, nsensordata)``."""
        (start, speed_before), state = self._before, self._state
        torques = sensors[..., self._torque]
        torque, square = torques.mean(1).numpy(), torques.square().mean(1).numpy()
        qpos, qvel = simulation.qpos.numpy(), simulation.qvel.numpy()
        now = qvel[:, self._speed]
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):  # worlds that diverged
            speed = (qpos[:, self._place] - start) / self._dt
            acceleration = (now - speed_before) / self._dt
            motor = torque - self._emf * speed
            damping = (self._emf + self._viscous) * self._value("joint_damping")
            inertia = self._armature * self._value("joint_armature")
            rubbed = (acceleration + self._reference * speed) / self._softness
            rubbed = np.clip(rubbed, -self._dry, self._dry)
            outside = inertia * acceleration - torque + damping * speed + rubbed
            state["load_friction"] = gear_friction(motor, outside, now, **self._load)
            inverse = np.where(self._full > 0, 1.0 / self._full, 0.0)
            duty = torque * inverse
            self._overload(np.abs(duty))
            if self._current is not None:
                limit = self._value("servo_torque_limit")
                emf = self._current * self._emf / self._stall * speed
                drawn = square * inverse**2 * self._current / self._voltage
                state["conductance"] = drawn.sum(1, keepdims=True)
                state["emf_current"] = (duty * emf).sum(1, keepdims=True)
                squares = (square - torque**2 + motor**2) / (self._stall * limit) ** 2
                self._heat(squares * self._voltage * self._current)

    def reset(self, simulation: Simulation, rows: Tensor) -> None:
        """Begins the episodes of the worlds in ``rows`` ``(N,)`` bool with rested servos.

        To be called before these worlds are put into their new state, whose sensor values depend
        on what the servos can give.
        """
        for value in self._state.values():
            value[rows.numpy()] = 0.0
        self._put(simulation, rows)

    def battery_voltage(self) -> Array:
        """``(N, 1)`` [V]."""
        return self._value("battery_voltage") * self._voltage

    def supply_voltage(self) -> Array:
        """What the last step leaves of it for the servos ``(N, 1)`` [V]."""
        battery, resistance = self.battery_voltage(), self._value("supply_resistance")
        fed_back = battery + resistance * self._state["emf_current"]
        voltage = fed_back / (1.0 + resistance * self._state["conductance"])
        return np.minimum(np.maximum(voltage, self._least), battery)

    def read(self, index: Tensor | None = None) -> dict[str, Tensor]:
        """What the env writes, of the worlds in ``index`` ``(K,)`` or of all, float32."""
        values = {
            "battery_voltage": self.battery_voltage(),
            "supply_voltage": self.supply_voltage(),
        }
        if self._thermal is not None:
            values["servo_temperature"] = AMBIENT + self._state["heating"]
        rows = slice(None) if index is None else index.numpy()
        return {key: torch.from_numpy(value[rows]).float() for key, value in values.items()}

    def state_dict(self) -> dict[str, Tensor]:
        """All that the coming steps depend on."""
        return {key: torch.from_numpy(value.copy()) for key, value in self._state.items()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Restores what ``state_dict`` gave."""
        self._state = {key: value.numpy().copy() for key, value in state.items()}

    def _put(self, simulation: Simulation, rows: Tensor) -> None:
        """Lets what the state says act in the worlds in ``rows`` ``(N,)`` bool."""
        state, at = self._state, rows.numpy()
        share = self.supply_voltage() / self._voltage
        limit = self._value("servo_torque_limit") * share
        self._full = self._stall * limit  # torque at full duty
        cut = np.where(state["overloaded"] > 0, self._remaining, 1.0)
        stiffness = self._value("servo_stiffness") * share
        added = self._value("load_friction") * state["load_friction"]
        factor = self._value("joint_friction_loss")
        self._dry = self._friction * factor + added
        zero = self._value("joint_zero_offset")
        fields = self._fields.actuators(stiffness[at], (limit * cut)[at], zero[at])
        simulation.set_fields(rows, fields | self._fields.friction(factor[at], added[at]))

    def _value(self, name: str) -> Array:
        return self._values[name].numpy().astype(np.float64)

    def _overload(self, duty: Array) -> None:
        state = self._state
        over = duty > self._share
        state["overload_time"] = np.where(over, state["overload_time"] + self._dt, 0.0)
        begins = state["overload_time"] > self._seconds - 0.5 * self._dt
        lasts = (state["overloaded"] > 0) & ~(duty < RELEASE * self._remaining)
        state["overloaded"] = (begins | lasts).astype(np.float64)

    def _heat(self, loss: Array) -> None:
        """Warms the windings by what is lost in them ``(N, J)`` [W]."""
        if self._thermal is not None:
            resistance, time = self._thermal
            end = resistance * loss
            self._state["heating"] = end + (self._state["heating"] - end) * np.exp(-self._dt / time)
