"""Draws docs/pictures/servos.png: torque over speed of the published servos and the sheets'.

``.venv/bin/python docs/draw_servos.py`` in the folder of the clone.
"""

from pathlib import Path

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from zfall.robots import ZEROTH01
from zfall.robots.servos import STS3215, STS3250

PICTURE = Path(__file__).parent / "pictures" / "servos.png"
SERVOS = {"left_knee_pitch": STS3250, "left_elbow_roll": STS3215}  # one joint of each kind


def main() -> None:
    """Writes the picture."""
    model = mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)
    figure = Figure(figsize=(7.0, 3.0), layout="constrained")
    for axes, (joint, servo) in zip(
        figure.subplots(1, 2, sharey=True), SERVOS.items(), strict=True
    ):
        hinge, speed = model.joint(joint), np.linspace(0.0, 9.0, 200)
        most = model.actuator(joint).forcerange[1]
        left = most - hinge.frictionloss[0] - hinge.damping[0] * speed
        axes.plot(speed, np.maximum(left, 0.0), "0.5", label="published")
        for volts, style in ((12.0, "-"), (11.1, "--")):
            left = [max(servo.shaft_torque(float(x), volts), 0.0) for x in speed]
            axes.plot(speed, left, f"C0{style}", label=f"datasheet, {volts:g} V")
        axes.set(title=servo.name, xlabel="speed [rad/s]", xlim=(0, 9), ylim=(0, 9))
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("torque at the shaft [N m]")
    figure.axes[0].legend(frameon=False)
    FigureCanvasAgg(figure).print_png(str(PICTURE), metadata={"Software": None})


if __name__ == "__main__":
    main()
