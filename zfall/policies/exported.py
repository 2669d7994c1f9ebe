"""A policy that was exported, read back from its folder: onnxruntime and numpy alone."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

KEYS = ("format", "robot", "control_dt_s", "ticks", "joints", "reference_rad", "low_rad",
        "high_rad", "sensors", "states", "config")  # fmt: skip
FORMAT = 2  # of policy.json


class ExportedPolicy:
    """``policy.onnx`` with its states, and ``policy.json``, which says what its numbers mean.

    Args:
        folder: of both files.

    Attributes:
        folder: of both files.
        about: content of ``policy.json``.
        states: what it keeps from step to step, by name.

    Raises:
        ValueError: without onnxruntime, or if the folder does not hold both files, as they are
            written together.
    """

    def __init__(self, folder: Path):
        self.folder, self.about = folder, _description(folder)
        try:
            import onnxruntime  # an extra of the package
        except ModuleNotFoundError:
            raise ValueError(
                'an exported policy needs onnxruntime: .venv/bin/pip install -e ".[export]"'
            ) from None
        if not (folder / "policy.onnx").is_file():
            raise ValueError(f"policy must be a folder with policy.onnx, got {folder} without it.")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self.session: Any = onnxruntime.InferenceSession(str(folder / "policy.onnx"), options)
        except Exception:  # onnxruntime's own kinds share no other class
            raise ValueError(
                f"policy.onnx must be a network that onnxruntime reads, got {folder}/policy.onnx; "
                "export it again."
            ) from None
        self.sizes = {each["name"]: each["size"] for each in self.about["sensors"]}
        self._check(folder)
        self.reset()

    def _check(self, folder: Path) -> None:
        """Whether network and description are of one robot."""
        expected = {"begin": [1, 1]} | {name: [1, size] for name, size in self.sizes.items()}
        expected |= {n: list(np.shape(start)) for n, start in self.about["states"].items()}
        joints, ticks = len(self.about["joints"]), self.about["ticks"]
        shapes = {value.name: value.shape for value in self.session.get_inputs()}
        command = {value.name: value.shape for value in self.session.get_outputs()}.get("command")
        for name in sorted(expected.keys() | shapes.keys(), key=str):
            if expected.get(name) != shapes.get(name):
                raise ValueError(
                    f"policy.onnx must be of the robot that policy.json describes, whose {name} "
                    f"has the shape {expected.get(name)}, got {shapes.get(name)} in {folder}; "
                    "export both together."
                )
        if command != [1, ticks, joints]:
            raise ValueError(
                f"policy.onnx must command {ticks} ticks of {joints} joints, as policy.json says, "
                f"got {command} in {folder}; export both together."
            )

    def reset(self) -> None:
        """Forgets: the next step is the first one of a robot that is switched on."""
        starts = self.about["states"].items()
        self.states = {name: np.array(start, np.float32) for name, start in starts}
        self.began = False

    def step(
        self, sensors: Mapping[str, NDArray[Any]]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """One control step.

        Args:
            sensors: quantities of one robot, by name, of any shape; what its operator gives, as a
                command, is 0 if it is left out.

        Returns:
            The action ``(J,)``, and the targets of the ticks of the control step ``(K, J)`` [rad].

        Raises:
            ValueError: if a quantity is missing that the robot measures.
        """
        by_robot = (each["name"] for each in self.about["sensors"] if each.get("by") != "operator")
        if missing := [name for name in by_robot if name not in sensors]:
            raise ValueError(f"sensors must have {missing[0]}, got {', '.join(sensors)}.")
        begin = np.full((1, 1), not self.began, np.float32)
        given = {
            name: np.asarray(sensors.get(name, np.zeros(size)), np.float32).reshape(1, size)
            for name, size in self.sizes.items()
        }
        action, command, *after = self.session.run(None, {"begin": begin, **given, **self.states})
        self.states = dict(zip(self.states, after, strict=True))
        self.began = True
        return action[0], command[0]


def _description(folder: Path) -> dict[str, Any]:
    path = folder / "policy.json"
    if not path.is_file():
        raise ValueError(
            f"policy must be a folder with policy.json, got {folder}; zfall export run=NAME "
            "writes one."
        )
    try:
        about = json.loads(path.read_text())
    except ValueError:
        about = None
    missing = [key for key in KEYS if not isinstance(about, dict) or key not in about]
    if missing or about["format"] != FORMAT:
        what = f"no {missing[0]}" if missing else f"format {about['format']}"
        raise ValueError(
            f"policy.json must be what this zfall exports, format {FORMAT}, got {what} in {path}; "
            "export the policy again."
        )
    return dict(about)
