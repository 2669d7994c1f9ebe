"""A network as ONNX, run by onnxruntime: a graph of operators, which reads and writes no files.

onnxruntime itself refuses weights that lie outside of the network's folder. Networks as rsl_rl
exports them: ``obs`` ``(1, D)`` -> ``actions`` ``(1, A)``, and of a recurrent one ``h_in`` (and
``c_in``) ``(layers, 1, H)`` -> ``h_out`` (``c_out``). Source: rsl_rl 5.5.1, ``as_onnx`` of its
models; Isaac Lab 2.3.2, ``_OnnxPolicyExporter``, the same names.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from zfall.policies.foreign.network import NetworkTable

Array = NDArray[np.float32]

_NUMBERS = {"tensor(float)": np.float32, "tensor(double)": np.float64}
_STATE_ENDS = ("_in", "_out")  # h_in -> h_out


class OnnxNetwork:
    """See ``zfall.policies.foreign.network.Network``.

    A network that was exported for one robot alone, with a batch of 1, is run row by row.

    Args:
        path: of the file.
        table: which inputs and outputs are which; what it leaves out is found by name and number.

    Raises:
        ValueError: without onnxruntime; if it is no ONNX, or its inputs and outputs cannot be told
            apart.
    """

    def __init__(self, path: Path, table: "NetworkTable"):
        self.name = path.name
        self.session = _session(path)
        self.inputs = {value.name: value for value in self.session.get_inputs()}
        self.outputs = {value.name: value for value in self.session.get_outputs()}
        for value in self.inputs.values():
            if value.type not in _NUMBERS:
                raise ValueError(
                    f"{self.name} must take numbers, float or double, got {value.name} of "
                    f"{value.type}; export it so."
                )
        self.after = self._states(table)
        rest = [name for name in self.inputs if name not in self.after]
        self.observation = _the_one(self.name, "input", "observation", rest, table)
        rest = [name for name in self.outputs if name not in self.after.values()]
        self.action = _the_one(self.name, "output", "action", rest, table)
        self.axes = {name: self._batch_axis(name) for name in self.after}
        axes = {self.observation: 0, **self.axes}
        self.rows = any(self.inputs[name].shape[axis] == 1 for name, axis in axes.items())
        self.states: Mapping[str, tuple[int, ...]] = {n: self._state_shape(n) for n in self.after}
        self.digest = _digest(path)

    def __call__(self, observation: Array, states: Sequence[Array]) -> tuple[Array, list[Array]]:
        """Actions and next states."""
        if not self.rows:
            return self._run(observation, states)
        parts = [
            self._run(observation[row : row + 1], [state[row : row + 1] for state in states])
            for row in range(len(observation))
        ]
        after = zip(*(part[1] for part in parts), strict=True)
        return np.concatenate([part[0] for part in parts]), [np.concatenate(s) for s in after]

    def check(self, observation: int, terms: str, action: int) -> None:
        """See ``Network``."""
        size = self.inputs[self.observation].shape[1:]
        if len(size) != 1 or (isinstance(size[0], int) and size[0] != observation):
            raise ValueError(
                f"observation must give what {self.name} takes as {self.observation}, "
                f"{_shape(size)} numbers, got {observation}: {terms}."
            )
        states = [np.zeros((1, *shape), np.float32) for shape in self.states.values()]
        try:
            found, after = self._run(np.zeros((1, observation), np.float32), states)
        except Exception as error:  # onnxruntime's own kinds share no other class
            reason = " ".join(str(error).split())[:200]
            raise ValueError(
                f"{self.name} must run with {observation} numbers as {self.observation}, got: "
                f"{reason}"
            ) from None
        if found.shape != (1, action):
            raise ValueError(
                f"joints must be as many as the numbers of {self.action} of {self.name}, "
                f"{_shape(found.shape[1:])}, got {action}."
            )
        if not np.isfinite(found).all():
            raise ValueError(
                f"{self.name} must give finite {self.action}, got {found[~np.isfinite(found)][0]} "
                f"of an observation of zeros."
            )
        for name, value, shape in zip(self.states, after, self.states.values(), strict=True):
            if value.shape[1:] != shape:
                raise ValueError(
                    f"{self.after[name]} of {self.name} must be of the shape of {name}, "
                    f"{_shape(shape)}, got {_shape(value.shape[1:])}."
                )

    def _run(self, observation: Array, states: Sequence[Array]) -> tuple[Array, list[Array]]:
        """In one call, batch axes first."""
        given = {self.observation: observation}
        for name, state in zip(self.states, states, strict=True):
            given[name] = np.moveaxis(state, 0, self.axes[name])
        typed = {
            name: np.ascontiguousarray(value, _NUMBERS[self.inputs[name].type])
            for name, value in given.items()
        }
        wanted = [self.action, *self.after.values()]
        action, *after = (np.asarray(each, np.float32) for each in self.session.run(wanted, typed))
        moved = zip(after, self.axes.values(), strict=True)
        return action, [np.moveaxis(value, axis, 0) for value, axis in moved]

    def _states(self, table: "NetworkTable") -> dict[str, str]:
        """Of each state the output that is its successor."""
        begin, end = _STATE_ENDS
        by_name = {name: name.removesuffix(begin) + end for name in self.inputs}
        found = {
            name: after
            for name, after in by_name.items()
            if name.endswith(begin) and after in self.outputs
        }
        given: Mapping[str, str] = table.get("states") or found
        for names, there, what in (
            (given, self.inputs, "input"),
            (given.values(), self.outputs, "output"),
        ):
            if missing := [name for name in names if name not in there]:
                raise ValueError(
                    f"network.states must name an {what} of {self.name} ({', '.join(there)}), "
                    f"got {missing[0]}."
                )
        return dict(given)

    def _batch_axis(self, name: str) -> int:
        """Which axis of a state counts robots: of length 1, or without a length."""
        shape = self.inputs[name].shape
        free = [axis for axis, size in enumerate(shape) if not isinstance(size, int)]
        axes = free or [axis for axis, size in enumerate(shape) if size == 1][-1:]
        if len(axes) != 1:
            raise ValueError(
                f"{name} of {self.name} must have one axis that counts robots, got "
                f"{_shape(shape)}; export it with a batch of 1."
            )
        return axes[0]

    def _state_shape(self, name: str) -> tuple[int, ...]:
        shape = list(self.inputs[name].shape)
        del shape[self.axes[name]]
        return tuple(shape)


def _session(path: Path) -> Any:
    try:
        import onnxruntime  # an extra of the package
    except ModuleNotFoundError:
        raise ValueError(
            'a policy as ONNX needs onnxruntime: .venv/bin/pip install -e ".[export]"'
        ) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own kinds share no other class
        reason = " ".join(str(error).split()).partition(" : FAIL : ")[-1][:200]
        hint = f": {reason}" if "External data" in reason else "; export it again."
        raise ValueError(
            f"network must be an ONNX that onnxruntime reads, got {path}{hint}"
        ) from None


def _digest(path: Path) -> bytes:
    """Of the file, and of the files next to it that hold weights of its graph."""
    import onnx  # of the same extra as onnxruntime

    content = path.read_bytes()
    tensors = onnx.load_from_string(content).graph.initializer
    others = {e.value for t in tensors for e in t.external_data if e.key == "location"}
    known = hashlib.sha256(content)
    for name in sorted(others):
        known.update((path.parent / name).read_bytes())
    return known.digest()


def _the_one(name: str, kind: str, key: str, rest: Sequence[str], table: "NetworkTable") -> str:
    """The name that the table gives, or the only one that there is."""
    given = table.get(key)
    if given is None and len(rest) == 1:
        return rest[0]
    if given is not None and given in rest:
        return str(given)
    got = f"got {given}" if given is not None else f"it has {len(rest)}"
    raise ValueError(
        f"network.{key} must name the {kind} of {name} that is the {key} "
        f"({', '.join(rest) or 'it has none'}), {got}."
    )


def _shape(sizes: Sequence[Any]) -> str:
    return " x ".join(str(size) for size in sizes) or "one"
