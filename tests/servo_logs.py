"""Logs that the simulation makes with a servo whose values are known."""

from dataclasses import replace

import numpy as np

from zfall.robots.servos import STS3250
from zfall.robots.servos.logs import Load, ServoLog
from zfall.simulation.bench import LateServo, run_bench

SECONDS = {"steps": 6.0, "chirp": 8.0, "pendulum": 8.0}
ARM = Load(mass=1.0, arm=0.15)


def drawn_servo(seed: int) -> LateServo:
    """An STS3250 whose values lie within 30 % of the sheet's, with play and latency."""
    rng = np.random.default_rng(seed)
    names = ("stall_torque", "no_load_speed", "duty_per_radian", "friction", "armature")
    values = {name: getattr(STS3250, name) * rng.uniform(0.7, 1.3) for name in names}
    play = rng.uniform(0.004, 0.018)
    servo = replace(STS3250, viscous_friction=None, backlash=play, **values)
    return LateServo(servo=servo, latency=rng.uniform(0.003, 0.03))


def simulated_log(unit: LateServo, kind: str, seed: int) -> ServoLog:
    """At some 100 Hz: a clock that jitters, a supply that sags, an encoder of 12 bits."""
    rng = np.random.default_rng([seed, 1])
    time = np.arange(0.0, SECONDS[kind], 0.01) + rng.uniform(0.0, 0.001, round(100 * SECONDS[kind]))
    time -= time[0]
    if kind == "chirp":  # 0.2 to 4 Hz
        target = 0.4 * np.sin(2 * np.pi * (0.2 * time + 1.9 * time**2 / time[-1]))
    else:
        levels = {
            "steps": [0.0, 0.1, -0.1, 1.5, -1.5, 0.5],
            "pendulum": [0, 1.5, 1.5, 0.2, 0.2, -1.2],
        }
        levels = levels[kind] + levels[kind][-1:] * 3
        target = np.array(levels)[time.astype(int)]
    log = ServoLog(
        name=kind,
        time=time,
        target=target,
        position=np.zeros_like(time),
        voltage=np.round(12.0 - 0.3 * np.abs(target), 1),
        load=ARM if kind == "pendulum" else Load(),
    )
    (exact,) = run_bench([unit], log, physics_dt=0.0005)
    step, zero = STS3250.resolution, rng.uniform(0.0, STS3250.resolution)
    return replace(log, position=np.round((exact + zero) / step) * step - zero)
