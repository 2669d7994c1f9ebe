"""What the base env observes after a step or a reset."""

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor

from zfall.envs.ball_state import BallState
from zfall.simulation.cpu import Simulation
from zfall.simulation.parameters import PhysicsParameters
from zfall.simulation.quantities import BALL, SUBSTEP_KEYS, Quantity
from zfall.simulation.read_quantities import QuantityReader
from zfall.simulation.servo_dynamics import ServoDynamics

Observed = dict[NestedKey, Tensor]


class Observer:
    """Puts together all quantities of the worlds.

    Args:
        read: gives the robot's quantities.
        parameters: of the physics.
        ball: the state of a ball, if there is one.
        servos: the dynamics of the servos, if they have some.

    Attributes:
        recorded: keys that are also written after each physics step.
    """

    def __init__(
        self,
        read: QuantityReader,
        parameters: PhysicsParameters,
        ball: BallState | None,
        servos: ServoDynamics | None,
    ):
        self._read, self._parameters, self._ball, self._servos = read, parameters, ball, servos
        self.recorded: tuple[str, ...] = ()

    def record(self, keys: Iterable[str]) -> list[str]:
        """Adds to ``recorded``; returns what is added.

        Raises:
            ValueError: on a key that is not known at every physics step.
        """
        keys = list(keys)
        unknown = [key for key in keys if key not in SUBSTEP_KEYS]
        if unknown:
            raise ValueError(
                f"keys must be known at every physics step ({', '.join(SUBSTEP_KEYS)}), "
                f"got {unknown[0]}."
            )
        self.recorded = tuple(dict.fromkeys((*self.recorded, *keys)))
        return keys

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What is observed in addition to ``QUANTITIES``."""
        return (*(BALL if self._ball else ()), *(self._servos.quantities if self._servos else ()))

    def __call__(
        self,
        simulation: Simulation,
        sensors: Tensor,
        index: Tensor | None = None,
        before: Observed | None = None,
    ) -> Observed:
        """All quantities ``(N, ...)``.

        Args:
            simulation: whose worlds.
            sensors: sensor values of the step ``(N, S, nsensordata)``.
            index: of worlds to observe anew ``(K,)``; all if ``None``.
            before: what the other worlds keep.
        """
        parameters = self._parameters
        states = (simulation.qpos, simulation.qvel)
        out = self._read(
            *states, sensors, parameters.gravity, parameters.mass, index=index, before=before
        )
        new: Observed = {}
        if self.recorded:
            arrays = _rows_of((*simulation.substates, sensors, parameters.gravity), index)
            by_step = self._read.substeps(self.recorded, *arrays)
            new |= {("substeps", key): value for key, value in by_step.items()}
        if self._ball:
            new |= self._ball.read(_rows_of(states, index))
        if self._servos:
            new |= self._servos.read(index)
        if index is not None and before is not None:
            new = {key: before[key].index_copy(0, index, value) for key, value in new.items()}
        return out | new


def copies(observed: Observed | None) -> Observed | None:
    """Of what was observed: the TensorDicts of users hold the tensors themselves."""
    return None if observed is None else {key: value.clone() for key, value in observed.items()}


def with_flags(observed: Mapping[NestedKey, Tensor], diverged: Tensor) -> TensorDictBase:
    """What was observed, and the flags: of the base env only failed physics ends an episode.

    Args:
        observed: values ``(N, ...)`` by key.
        diverged: where the physics failed ``(N, 1)`` bool.
    """
    flags = {key: diverged.clone() for key in ("diverged", "terminated", "done")}
    flags["truncated"] = torch.zeros_like(diverged)
    flat = {key: value for key, value in observed.items() if isinstance(key, str)}
    # Without the checks of each value, whose shapes are known: they take longer than the rest.
    out = TensorDict._new_unsafe(flat | flags, batch_size=diverged.shape[:1])
    for key, value in observed.items():
        if key not in flat:
            out[key] = value
    return out


def _rows_of(arrays: Iterable[Tensor | None], index: Tensor | None) -> list[Any]:
    """The rows in ``index`` ``(K,)`` of each, all if it is ``None``; ``None`` stays."""
    if index is None:
        return list(arrays)
    return [None if array is None else array.index_select(0, index) for array in arrays]
