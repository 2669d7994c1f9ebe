"""Draws docs/pictures/servos.png and servo_responses.png: servos by sheets, and tests of them.

``.venv/bin/python docs/draw_servos.py`` in the folder of the clone.
"""

import math
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.optimize import brentq

from zfall.evaluation.plots.colors import BLUE, GREY, SKY, VERMILION
from zfall.robots import GRAVITY, ZEROTH01
from zfall.robots.servos import STS3215, STS3250, Servo
from zfall.robots.servos.datasheets import servo
from zfall.robots.servos.logs import Load, ServoLog
from zfall.simulation.bench import LateServo, run_bench

PICTURES = Path(__file__).parent / "pictures"
KINDS = {  # a joint of each kind of servo, and where else on the robot it is
    "left_knee_pitch": (STS3250, "legs, shoulders"),
    "left_elbow_roll": (STS3215, "elbows, grippers"),
}
# Public test of a 12 V STS3215: 1.5 kg on a lever of 0.1 m at 45 degrees, errors of 20 to 30
# steps of the encoder. Of a desk arm it is reported that it goes a quarter of the way in each
# tick of 1/30 s; the curve is what follows from this one number.
HELD = 1.5 * GRAVITY * 0.1 * math.sin(math.pi / 4)  # [N m]
MEASURED_ERROR = (20 * STS3215.resolution, 30 * STS3215.resolution)  # [rad]
TICK, SHARE = 1 / 30, 0.25  # [s], (1)
LATENCY = 0.025  # the middle of the twin's, jitter included [s]
STEP = 0.1  # [rad]


def main() -> None:
    """Writes the pictures."""
    model = mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)
    figure = Figure(figsize=(8.0, 3.4), dpi=200, layout="constrained")
    pair = zip(figure.subplots(1, 2, sharey=True), KINDS.items(), strict=True)
    for axes, (joint, (each, where)) in pair:
        draw_torque(axes, model, joint, each)
        axes.set_title(f"{each.name} ({where})")
    figure.axes[0].set_ylabel("torque at the shaft [N m]")
    figure.axes[0].legend(frameon=False)
    FigureCanvasAgg(figure).print_png(str(PICTURES / "servos.png"), metadata={"Software": None})
    figure = Figure(figsize=(8.0, 3.4), dpi=200, layout="constrained")
    steps, errors = figure.subplots(1, 2)
    draw_steps(steps)
    draw_errors(errors)
    path = PICTURES / "servo_responses.png"
    FigureCanvasAgg(figure).print_png(str(path), metadata={"Software": None})


def draw_torque(axes: Axes, model: mujoco.MjModel, joint: str, each: Servo) -> None:
    """Torque over speed, of the MJCF's actuator and of the sheet's motor."""
    hinge, speed = model.joint(joint), np.linspace(0.0, 9.0, 200)
    most = model.actuator(joint).forcerange[1]
    left = most - hinge.frictionloss[0] - hinge.damping[0] * speed
    axes.plot(speed, np.maximum(left, 0.0), color=GREY, label="published with the robot")
    for volts, style in ((12.0, "-"), (11.1, "--")):
        left = [max(each.shaft_torque(float(x), volts), 0.0) for x in speed]
        axes.plot(speed, left, style, color=BLUE, label=f"maker's sheet, {volts:g} V")
    axes.set(xlabel="speed [rad/s]", xlim=(0, 8.5), ylim=(0, 9))
    axes.grid(alpha=0.3)


def draw_steps(axes: Axes) -> None:
    """Responses of a shaft without a load to a small step, and of the desk arm as reported."""
    time = np.arange(0.0, 0.601, 0.002)
    target, nothing = np.where(time < 0.01, 0.0, STEP), np.zeros(len(time))
    log = ServoLog(
        name="step", time=time, target=target, position=nothing, voltage=nothing + 12.0, load=Load()
    )
    for kp, style in ((32, "-"), (16, "--")):
        each = servo("STS3215", kp=kp, backlash=0.0)
        (moved,) = run_bench([LateServo(servo=each, latency=LATENCY)], log, physics_dt=0.001)
        axes.plot(
            1e3 * (time - 0.01), moved / STEP, style, color=BLUE, label=f"computed, gain kp {kp}"
        )
    ticks = np.linspace(0.0, 18.0, 181)
    reported = 1.0 - (1.0 - SHARE) ** ticks
    label = f"desk arm, as reported:\n{100 * SHARE:.0f} % of the way per 1/30 s"
    axes.plot(1e3 * TICK * ticks, reported, "-.", color=VERMILION, label=label)
    axes.set(title="STS3215, step of 0.1 rad", xlabel="time [ms]", ylabel="share of the step")
    axes.set(xlim=(0, 600), ylim=(-0.02, 1.3))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, loc="lower right", fontsize=9)


def draw_errors(axes: Axes) -> None:
    """Errors at rest, from a load just let down to one just lifted, and those of a test."""
    before_gears, loads = STS3215.before_gears(), np.linspace(0.0, 1.5, 61)

    def error(load: float, sign: float) -> float:  # the friction acts against the motion, or holds
        def rest(motor: float) -> float:
            return motor - load - sign * STS3215.gear_friction(motor, -load, 0.0)  # E against M

        return math.degrees(brentq(rest, -1.0, 5.0) / before_gears.stiffness())

    axes.fill_between(
        loads,
        [error(load, -1.0) for load in loads],
        [error(load, 1.0) for load in loads],
        color=SKY,
        alpha=0.5,
        label="computed, from let down to lifted",
    )
    low, high = (
        np.degrees((loads + sign * STS3215.need("friction")) / STS3215.stiffness())
        for sign in (-1.0, 1.0)
    )
    axes.fill_between(
        loads, low, high, color=GREY, alpha=0.5, label="computed, without losses under load"
    )
    label = "public test, one load, 20 to\n30 encoder steps"
    axes.plot([HELD] * 2, np.degrees(MEASURED_ERROR), color=VERMILION, linewidth=4, label=label)
    axes.set(title="STS3215 at rest, gain kp 32", xlabel="load [N m]", ylabel="error [deg]")
    axes.set(xlim=(0, 1.5), ylim=(0, 8.0))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, loc="upper left", fontsize=9)


if __name__ == "__main__":
    main()
