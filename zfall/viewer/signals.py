"""What is read from a world while it runs, and its plots."""

import json
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import viser
from tensordict import TensorDictBase

from zfall.envs.terms.balance import capture_point_offset
from zfall.rotations import tilt

SECONDS = 8.0  # of the past that a plot shows
COLORS = ("#2f6db5", "#d9822b", "#3f9142", "#b0413e", "#7a5195", "#5f6b77", "#00a3a3", "#c2a000")
TITLES = {
    "tilt": "tilt [degrees]",
    "capture": "capture point from the feet [cm]",
    "torque": "largest joint torque [N m]",
    "reward": "reward terms of a step",
    "fall": "probability of a fall",
}


def read_signals(seen: TensorDictBase, world: int) -> dict[str, dict[str, float]]:
    """What the plots show of one world after a step: by plot, by line.

    Args:
        seen: what followed the step of N worlds.
        world: its number.
    """
    td = seen[world : world + 1]
    xi = capture_point_offset(td)[0]
    signals = {
        "tilt": {"tilt": float(np.degrees(float(tilt(td["base_orientation"]))))},
        "capture": {"forward": 100 * float(xi[0]), "left": 100 * float(xi[1])},
        "torque": {"torque": float(td["joint_torque"].abs().max())},
        "reward": {},
    }
    if "reward_terms" in td.keys():
        terms = td["reward_terms"]
        signals["reward"] = {str(name): float(terms[name]) for name in terms.keys()}
    if "fall_probability" in td.keys():
        signals["fall"] = {"probability": float(td["fall_probability"])}
    return signals


class Plots:
    """Lines of the last seconds, in the panel of the browser.

    Args:
        server: of viser.
    """

    def __init__(self, server: viser.ViserServer):
        self._label = ""
        self._times: deque[float] = deque()
        self._lines: dict[str, dict[str, deque[float]]] = {}
        self._handles = {
            name: server.gui.add_plotly(_figure(title, {}, []), aspect=1.9)
            for name, title in TITLES.items()
        }
        self._handles["fall"].visible = False

    def watch(self, label: str) -> None:
        """Begins anew when another robot is watched."""
        if label != self._label:
            self._label = label
            self.clear()

    def clear(self) -> None:
        """Forgets what was, as another policy or world is shown."""
        self._times.clear()
        self._lines.clear()

    def add(self, time: float, signals: Mapping[str, Mapping[str, float]]) -> None:
        """Adds what ``read_signals`` gave for a time [s]."""
        self._times.append(time)
        for plot, lines in signals.items():
            for name, value in lines.items():
                self._lines.setdefault(plot, {}).setdefault(name, deque()).append(value)
        while self._times[-1] - self._times[0] > SECONDS:
            self._times.popleft()
            for kept in self._lines.values():
                for line in kept.values():
                    line.popleft()

    def draw(self) -> None:
        """Sends the plots to the browser."""
        if not self._times:
            return
        now = self._times[-1]
        times = [round(time - now, 3) for time in self._times]
        for name, title in TITLES.items():
            lines = self._lines.get(name, {})
            self._handles[name].visible = bool(lines)
            if lines:
                self._handles[name].figure = _figure(title, lines, times)


class _Figure:
    """A figure as plain JSON; plotly's own class takes 0.4 s to check one like it."""

    def __init__(self, title: str, lines: Mapping[str, Sequence[float]], times: Sequence[float]):
        data = [
            {
                "type": "scatter",
                "mode": "lines",
                "name": name,
                "x": list(times),
                "y": [float(f"{value:.4g}") for value in line],
                "line": {"color": COLORS[place % len(COLORS)], "width": 1.5},
            }
            for place, (name, line) in enumerate(lines.items())
        ]
        layout = {
            "title": {"text": title, "font": {"size": 12}, "x": 0.02, "y": 0.97},
            "margin": {"l": 34, "r": 6, "t": 24, "b": 22},
            "font": {"size": 10},
            "showlegend": len(lines) > 1,
            "legend": {"orientation": "h", "font": {"size": 8}, "y": -0.12},
            "xaxis": {"range": [-SECONDS, 0.0]},
        }
        self._json = json.dumps({"data": data, "layout": layout})

    def to_json(self) -> str:
        """What viser sends to the browser."""
        return self._json


def _figure(title: str, lines: Mapping[str, Sequence[float]], times: Sequence[float]) -> Any:
    return _Figure(title, lines, times)
