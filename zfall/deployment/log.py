"""What a drive leaves behind: a row per control step, and a few lines at its end."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

COLUMNS = (
    *("time_s", "late_s", "latency_s", "network_s"),
    *("joint", "temperature_c", "clipped", "event"),
)


class Log:
    """Writes ``drive.csv`` row by row, so that it is there whatever happens.

    Columns: ``time_s``; ``late_s``, by how much the step began after its time; ``latency_s``, from
    the first reading to the targets of the first tick; ``network_s``, the network's share of it;
    ``temperature_c`` of ``joint``, another one in each step, empty if it did not answer;
    ``clipped``, targets that were cut off at the joint limits; ``event``; and of each joint
    ``position/JOINT`` and ``target/JOINT`` [rad].

    Args:
        path: of the file; ``None`` keeps the figures alone.
        joints: of the robot.
    """

    def __init__(self, path: Path | None, joints: Sequence[str]):
        self.steps: list[dict[str, Any]] = []
        self.events: list[str] = []
        self.file = None if path is None else path.open("w", newline="", buffering=1)
        names = [f"{key}/{joint}" for key in ("position", "target") for joint in joints]
        self.writer = self.file and csv.DictWriter(self.file, [*COLUMNS, *names])
        if self.writer:
            self.writer.writeheader()
        self.joints = joints

    def step(
        self, row: Mapping[str, Any], position: Sequence[float], target: Sequence[float]
    ) -> None:
        """A control step: its columns, and the angles of all joints [rad]."""
        self.steps.append(dict(row))
        angles = {f"position/{j}": f"{x:.5f}" for j, x in zip(self.joints, position, strict=True)}
        angles |= {f"target/{j}": f"{x:.5f}" for j, x in zip(self.joints, target, strict=True)}
        shown = {k: f"{x:.6f}" if isinstance(x, float) else x for k, x in row.items()}
        if self.writer:
            self.writer.writerow(shown | angles)

    def event(self, time: float, text: str) -> None:
        """Something that happened [s]."""
        self.events.append(text)
        if self.writer:
            self.writer.writerow({"time_s": f"{time:.6f}", "event": text})

    def close(self) -> None:
        """Closes the file."""
        if self.file:
            self.file.close()

    def report(self, control_dt: float) -> list[str]:
        """A few lines on the rate, jitter, latency and temperature of the steps.

        Args:
            control_dt: time between two steps, as the policy has it [s].
        """
        if not self.steps:
            return ["no control step was taken"]
        column = {key: np.array([row[key] for row in self.steps], float) for key in COLUMNS[:4]}
        time, count = column["time_s"], len(self.steps)
        rate = (count - 1) / (time[-1] - time[0]) if count > 1 else 0.0
        over = int((column["latency_s"] > control_dt).sum())
        return [
            f"{count} control steps at {rate:.2f} Hz, the policy's rate is {1 / control_dt:.2f} Hz",
            _line("jitter", "a step begins late by", column["late_s"]),
            _line("latency", "sensors to targets", column["latency_s"])
            + f", {over} longer than a step",
            f"{self._heat()}; {sum(row['clipped'] for row in self.steps)} targets cut off at joint "
            "limits",
        ]

    def _heat(self) -> str:
        told = [row for row in self.steps if row["temperature_c"] is not None]
        if not told:
            return "no servo answered with its temperature"
        hottest = max(told, key=lambda row: row["temperature_c"])
        line = f"hottest {hottest['joint']}, {hottest['temperature_c']:.0f} degrees Celsius"
        silent = len(self.steps) - len(told)
        return line + (f", {silent} of {len(self.steps)} temperatures unknown" if silent else "")


def _line(name: str, what: str, seconds: np.ndarray) -> str:
    middle, high, most = 1e3 * np.quantile(seconds, [0.5, 0.99, 1.0])
    return f"{name}: {what} {middle:.2f} ms (median), {high:.2f} (99 %), {most:.2f} (largest)"
