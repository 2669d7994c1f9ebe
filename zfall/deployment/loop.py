"""The loop: sensors, network, targets, at the rate of the policy."""

import math
import time as clock
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import cycle
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zfall.deployment import bus as registers
from zfall.deployment.bus import Bus, to_angle, to_steps
from zfall.deployment.log import Log
from zfall.errors import in_one_line
from zfall.policies.exported import ExportedPolicy

RETRY = 0.005  # time after which servos that did not answer are asked again [s]
UNREAD = 3  # temperatures of a servo in a row that may stay without an answer


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How a robot is driven.

    Args:
        kp: of the position loop, of all servos; ``None`` takes that of ``policy.json``.
        acceleration: of the firmware's ramp; 0 is none.
        ceiling: of the ramp.
        torque_limit: share of the largest torque.
        settle: time in which the robot goes to its reference pose and comes to rest there, before
            the policy acts [s]: its estimators begin with what the sensors say then.
        watchdog: time without an answer of a servo after which the robot is stopped [s].
        margin: by which targets stay away from the ends of the joints' ranges [rad].
        hottest: temperature of a servo at which the robot is stopped [degree Celsius], as it is
            when a servo leaves three questions for its temperature in a row unanswered; ``None``:
            temperatures are logged and stop nothing.
        stop: what stops it: ``hold`` leaves the servos where they were sent last, ``limp``
            switches their torque off.
    """

    kp: int | None = None
    acceleration: int = 0
    ceiling: int = 254
    torque_limit: float = 1.0
    settle: float = 1.0
    watchdog: float = 0.05
    margin: float = 0.0
    hottest: float | None = 65.0
    stop: Literal["hold", "limp"] = "hold"


class Stopped(Exception):
    """The robot was stopped, and why."""


def check_fit(policy: ExportedPolicy, bus: Bus) -> None:
    """Refuses a robot that a policy was not made for, or that does not measure what it reads.

    Raises:
        ValueError: naming what differs.
    """
    about = policy.about
    if about["robot"] != bus.robot or about["joints"] != list(bus.joints):
        raise ValueError(
            f"policy must be of the robot on the bus, {bus.robot} with {len(bus.joints)} joints, "
            f"got one of {about['robot']} with {len(about['joints'])}."
        )
    there = {"joint_position", *bus.quantities}
    asked = [each["name"] for each in about["sensors"] if each.get("by") != "operator"]
    missing = [name for name in asked if name not in there]
    if missing:
        raise ValueError(
            f"policy must read what the robot measures ({', '.join(sorted(there))}), got one that "
            f"reads {missing[0]}; bus=nominal simulates a robot that measures everything."
        )


def drive(
    policy: ExportedPolicy,
    bus: Bus,
    *,
    seconds: float,
    log: Log,
    settings: Settings = Settings(),
    over: Callable[[], bool] = lambda: False,
) -> None:
    """Drives a robot that stands in its reference pose.

    In each control step: all joints' angles and the IMU are read, the network is run, and its
    targets are sent, those of later ticks at their times.

    Args:
        policy: what was exported; it begins anew.
        bus: the robot.
        seconds: for how long [s].
        log: is given each step.
        settings: registers and limits.
        over: ends the drive before, if true after a step.

    Raises:
        Stopped: if a servo did not answer for too long, is too hot, or a sensor or a target is no
            number; the robot has been stopped, and the log says so. Also if switching the torque
            off failed, whatever the first error was: it names both.
        ValueError: if policy and robot do not fit, or the policy would never act.
    """
    check_fit(policy, bus)
    if seconds <= settings.settle:
        raise ValueError(
            f"seconds must be above settings.settle, {settings.settle:g}, before which the policy "
            f"does not act, got {seconds:g}."
        )
    policy.reset()
    _Drive(policy, bus, log, settings).run(seconds, over)


class _Drive:
    def __init__(self, policy: ExportedPolicy, bus: Bus, log: Log, settings: Settings):
        self.policy, self.bus, self.log, self.settings = policy, bus, log, settings
        about = policy.about
        self.joints, self.dt = about["joints"], float(about["control_dt_s"])
        self.tick = self.dt / about["ticks"]
        self.low = np.array(about["low_rad"]) + settings.margin
        self.high = np.array(about["high_rad"]) - settings.margin
        self.reference = np.array(about["reference_rad"])
        self.answered = bus.now()  # when all servos did last
        self.watched = cycle(self.joints)  # one temperature in each step
        self.unread: Counter[str] = Counter()  # temperatures in a row, by joint

    def run(self, seconds: float, over: Callable[[], bool]) -> None:
        try:
            self.start()
            # Control steps begin at multiples of their length: a simulated robot measures there.
            begin = math.ceil(self.bus.now() / self.dt - 1e-9) * self.dt
            self.bus.wait_until(begin)
            still = round(self.settings.settle / self.dt)
            pose = np.array(list(self.read_positions().values()))
            for step in range(round(seconds / self.dt)):
                due = begin + step * self.dt
                self.bus.wait_until(due)
                if step < still:
                    self.read_positions()  # for the watchdog
                    share = min(1.0, 2.0 * (step + 1) / still)
                    target = (1.0 - share) * pose + share * self.reference
                    self.send(np.clip(target, self.low, self.high))
                    continue
                self.step(due)
                if over():
                    break
            self.bus.wait_until(begin + seconds if not over() else self.bus.now())
        except (Exception, KeyboardInterrupt) as error:
            self.halt(error)
            raise

    def halt(self, error: BaseException) -> None:
        """Stops the robot for an error, and says so.

        Raises:
            Stopped: if the bus fails at that, too.
        """
        by_hand = isinstance(error, KeyboardInterrupt)
        why = str(error) if isinstance(error, Stopped) else in_one_line(error)
        why = "by hand" if by_hand else why or repr(error)
        servos: str = self.settings.stop
        failed: Exception | None = None
        time = self.answered
        try:
            if self.settings.stop == "limp":
                self.write(registers.TORQUE_ENABLE, 0)
            time = self.bus.now()
        except Exception as second:
            servos, failed = "not limp", second
            why = f"{why}; switching their torque off failed too: {in_one_line(second)}"
        self.log.event(time, f"stopped, servos {servos}: {why}")
        if failed is not None:
            raise Stopped(why) from error

    def start(self) -> None:
        """Writes the registers that a servo forgets when it is switched off."""
        settings, kp = self.settings, self.policy.about.get("kp")
        gains = dict(zip(self.joints, kp, strict=True)) if kp else {}
        if settings.kp is not None:
            gains = dict.fromkeys(self.joints, settings.kp)
        if gains:
            self.bus.write(registers.KP, gains)
        self.write(registers.ACCELERATION, settings.acceleration)
        self.write(registers.CEILING, settings.ceiling)
        self.write(registers.TORQUE_LIMIT, round(1000 * settings.torque_limit))
        self.send(np.array(list(self.read_positions().values())))  # no jump when torque comes on
        self.write(registers.TORQUE_ENABLE, 1)

    def write(self, register: registers.Register, value: int) -> None:
        self.bus.write(register, dict.fromkeys(self.joints, value))

    def read_positions(self) -> dict[str, float]:
        """Angles of all joints [rad]; asks again until all answer, or the watchdog times out.

        Raises:
            Stopped: after ``watchdog`` seconds without an answer.
        """
        found: dict[str, int] = {}
        while True:
            missing = [joint for joint in self.joints if joint not in found]
            found |= self.bus.read(registers.PRESENT_POSITION, missing)
            silent = [joint for joint in self.joints if joint not in found]
            if not silent:
                self.answered = self.bus.now()
                return {joint: to_angle(found[joint]) for joint in self.joints}
            without = self.bus.now() - self.answered
            if without > self.settings.watchdog:
                raise Stopped(
                    f"no answer of {len(silent)} of {len(self.joints)} servos, {silent[0]} first, "
                    f"for {1e3 * without:.0f} ms"
                )
            self.bus.wait_until(self.bus.now() + RETRY)

    def step(self, due: float) -> None:
        began, at = clock.perf_counter(), self.bus.now()
        positions = self.read_positions()
        angles = np.array(list(positions.values()))
        sensors: Mapping[str, NDArray[np.float32]] = self.bus.sense()
        network = clock.perf_counter()
        for name, value in sensors.items():
            if not np.isfinite(value).all():
                raise Stopped(f"the robot measured a {name} that is no number")
        action, command = self.policy.step({**sensors, "joint_position": angles})
        network = clock.perf_counter() - network
        if not (np.isfinite(action).all() and np.isfinite(command).all()):
            raise Stopped("the network gave a target that is no number")
        targets = np.clip(command, self.low, self.high)
        self.send(targets[0])
        latency = clock.perf_counter() - began
        joint = next(self.watched)
        heat = self.bus.read(registers.PRESENT_TEMPERATURE, [joint]).get(joint)
        row = {
            "time_s": at,
            "late_s": at - due,
            "latency_s": latency,
            "network_s": network,
            "joint": joint,
            "temperature_c": heat,
            "clipped": int((np.abs(targets - command) > 1e-6).sum()),
        }
        self.log.step(row, angles.tolist(), targets[0].tolist())
        self.check_heat(joint, heat)
        for number, target in enumerate(targets[1:], 1):
            self.bus.wait_until(due + number * self.tick)
            self.send(target)

    def check_heat(self, joint: str, heat: int | None) -> None:
        """Whether a servo is cold enough, and says so.

        Raises:
            Stopped: if it is not.
        """
        hottest = self.settings.hottest
        self.unread[joint] = self.unread[joint] + 1 if heat is None else 0
        if hottest is None:
            return
        if heat is not None and heat >= hottest:
            raise Stopped(f"{joint} has {heat} degrees Celsius, at most {hottest:g}")
        if self.unread[joint] >= UNREAD:
            raise Stopped(
                f"no temperature of {joint} for {UNREAD} questions; settings.hottest=null drives "
                "without"
            )

    def send(self, target: NDArray[np.floating]) -> None:
        """Sends a target to each servo ``(J,)`` [rad]."""
        steps = {joint: to_steps(x) for joint, x in zip(self.joints, target, strict=True)}
        self.bus.write(registers.GOAL_POSITION, steps)
