"""The panel of the viewer: what a person can set, and what it tells the viewer."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
import viser
from torch import Tensor

from zfall.viewer.player import LONGEST_DELAY

SIDES = {0: "forward", 90: "to the left", 180: "backward", -90: "to the right"}


@dataclass(frozen=True)
class Push:
    """A push as the panel asks for it.

    Args:
        size: dimensionless impulse.
        direction: that it pushes toward [rad]; 0 forward, pi/2 to the left.
        point: a push point.
        duration: [s].
        who: ``everybody``, or the label of a robot.
    """

    size: float
    direction: float
    point: str
    duration: float
    who: str

    def impulse(self, unit: float) -> Tensor:
        """``(3,)`` [N s; world], for the impulse of dimensionless size 1 [N s]."""
        level = [math.cos(self.direction), math.sin(self.direction), 0.0]
        return self.size * unit * torch.tensor(level)


@dataclass(frozen=True)
class Told:
    """What the panel calls, each with what was set.

    Args:
        choose: a run and whom to compare it with.
        push: a push.
        reset: all worlds.
        world: latency [s] and physical parameters by name.
    """

    choose: Callable[[str, str], None]
    push: Callable[[Push], None]
    reset: Callable[[], None]
    world: Callable[[float, dict[str, float]], None]


class Controls:
    """The panel.

    Args:
        server: of viser.
        told: what it calls.
        choices: runs to choose from.
        others: whom they can be compared with.
        run, compare: what is chosen at first.
        unit: the impulse of dimensionless size 1 [N s].
        points: push points.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        told: Told,
        choices: Sequence[str],
        others: Sequence[str],
        *,
        run: str,
        compare: str,
        unit: float,
        points: Sequence[str],
    ):
        gui, self._unit, self._told = server.gui, unit, told
        self.status = gui.add_markdown("")
        with gui.add_folder("Push"):
            self.size = gui.add_slider("size I", 0.0, 3.0, 0.05, 0.5)
            self.direction = gui.add_slider("toward [deg]", -180, 180, 5, 90)
            self.point = gui.add_dropdown(
                "point", tuple(points), "torso" if "torso" in points else None
            )
            self.duration = gui.add_slider("duration [s]", 0.02, 0.5, 0.02, 0.1)
            self.who = gui.add_dropdown("robots", ("everybody",))
            self.force = gui.add_markdown("")
            self.push = gui.add_button("push", color="red")
        with gui.add_folder("Time"):
            self.paused = gui.add_checkbox("pause", False)
            self.speed = gui.add_slider("speed", 0.05, 1.0, 0.05, 1.0)
            self.rise = gui.add_checkbox("stand up after a fall", True)
            self.reset = gui.add_button("reset")
        with gui.add_folder("Policy"):
            self.run = gui.add_dropdown("run", tuple(choices), run)
            self.compare = gui.add_dropdown("compare", tuple(others), compare)
            self.reload = gui.add_checkbox("take new weights", True)
        with gui.add_folder("World", expand_by_default=False):
            self.latency = gui.add_slider("latency [ms]", 0, 1000 * LONGEST_DELAY, 4, 0)
            self.voltage = gui.add_slider("voltage [%]", 80, 120, 1, 100)
            self.friction = gui.add_slider("foot friction", 0.1, 2.0, 0.05, 1.0)
            self.payload = gui.add_slider("chest load [kg]", 0.0, 1.5, 0.05, 0.0)
            self.slope = gui.add_slider("slope [deg]", -12.0, 12.0, 0.5, 0.0)
            self.nominal = gui.add_button("as it was")
        with gui.add_folder("Signals"):
            self.watched = gui.add_dropdown("robot", ("",))
            self.follow = gui.add_checkbox("follow it", True)
            self.plotted = gui.add_checkbox("plots", True)
            self.readout = gui.add_markdown("")
        self._worlds: tuple[Any, ...] = (
            self.latency,
            self.voltage,
            self.friction,
            self.payload,
            self.slope,
        )
        self._first = [slider.value for slider in self._worlds]
        self._connect()
        self._say_force()

    def _connect(self) -> None:
        for slider in (self.size, self.direction, self.duration):
            slider.on_update(lambda _: self._say_force())
        self.push.on_click(lambda _: self._told.push(self.asked()))
        self.reset.on_click(lambda _: self._told.reset())
        for picker in (self.run, self.compare):
            picker.on_update(lambda _: self._told.choose(self.run.value, self.compare.value))
        for slider in self._worlds:
            slider.on_update(lambda _: self._told.world(*self.world()))
        self.nominal.on_click(lambda _: self._as_it_was())

    def asked(self) -> Push:
        """The push that is set."""
        return Push(
            self.size.value,
            math.radians(self.direction.value),
            self.point.value,
            self.duration.value,
            self.who.value,
        )

    def world(self) -> tuple[float, dict[str, float]]:
        """Latency [s], and by name the physical parameters whose sliders were moved."""
        _, voltage, friction, payload, slope = self._first
        moved = {}
        if self.voltage.value != voltage:
            moved["battery_voltage"] = self.voltage.value / 100
        if self.friction.value != friction:
            moved["foot_friction"] = self.friction.value
        if self.payload.value != payload:
            moved["payload"] = self.payload.value
        if self.slope.value != slope:
            moved["slope"] = math.radians(self.slope.value)
        return self.latency.value / 1000, moved

    def name_robots(self, labels: Sequence[str]) -> None:
        """Offers these robots to be pushed and watched."""
        self.who.options, self.watched.options = ("everybody", *labels), tuple(labels)
        self.who.value, self.watched.value = "everybody", labels[0]

    def _as_it_was(self) -> None:
        for slider, value in zip(self._worlds, self._first, strict=True):
            slider.value = value

    def _say_force(self) -> None:
        push = self.asked()
        newtons = push.size * self._unit / push.duration
        side = SIDES.get(round(self.direction.value), f"toward {self.direction.value:g} degrees")
        self.force.content = f"{newtons:.1f} N for {push.duration:g} s, {side}"
