"""How worlds are put into the state that an episode starts in."""

from collections.abc import Mapping

import mujoco
import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.robots import Robot
from zfall.simulation.cpu import Simulation
from zfall.simulation.quantities import STATE_KEYS

START_KEYS = (*STATE_KEYS, "clearance")


def start_of(tensordict: TensorDictBase) -> dict[str, Tensor]:
    """What a reset's TensorDict says of the start, ``("start", NAME)`` of ``START_KEYS``."""
    there = tensordict.keys(True)
    return {key: tensordict["start", key] for key in START_KEYS if ("start", key) in there}


class Placing:
    """Puts worlds into the standing pose, or into what ``start`` says.

    Its keys are ``START_KEYS``. Without ``base_position``, or where that is NaN, the lowest corner
    of the soles is put on the floor, or ``clearance`` ``(N, 1)`` [m] above it.

    Args:
        robot: gives the feet.
        model: the compiled model.
        places: where each component of the state lies, see ``QuantityReader``.
        control: actuator inputs of the standing pose ``(nu,)``, float64.
    """

    def __init__(
        self,
        robot: Robot,
        model: mujoco.MjModel,
        places: Mapping[str, tuple[str, Tensor | slice]],
        control: Tensor,
    ):
        self._places, self._control = places, control
        self._stand = torch.tensor(model.key("stand").qpos.copy())
        self._soles = [int(model.sensor(f"feet_position/{foot}").objid[0]) for foot in robot.feet]
        self._sole_half_size = np.array(robot.sole_half_size)

    def place(self, simulation: Simulation, rows: Tensor, start: Mapping[str, Tensor]) -> Tensor:
        """Puts worlds into their start state.

        Args:
            simulation: whose worlds.
            rows: which of them ``(N,)`` bool.
            start: by key, values ``(N, ...)``.

        Returns:
            The sensor values of all worlds, see ``Simulation.reset``.
        """
        count = int(rows.sum())
        qpos = self._stand.expand(count, -1).clone()
        qvel = torch.zeros(count, simulation.qvel.shape[1], dtype=torch.float64)
        states = {"qpos": qpos, "qvel": qvel}
        for key in start.keys() & self._places.keys():
            array, columns = self._places[key]
            states[array][:, columns] = start[key][rows].double()
        floor = torch.full((count,), bool(start))  # rows that are put on it
        if "base_position" in start:
            floor = qpos[:, 0].isnan()
            qpos[floor, :3] = self._stand[:3]
        if floor.any():
            lift = -self._clearance(simulation, qpos)
            if "clearance" in start:
                lift += start["clearance"][rows, 0]
            qpos[:, 2] += torch.where(floor, lift, 0.0)
        return simulation.reset(rows, qpos, qvel, self._control.expand(count, -1))

    def _clearance(self, simulation: Simulation, qpos: Tensor) -> Tensor:
        """Height of the lowest corner of the soles above the floor ``(K,)`` [m]."""
        position, rotation = simulation.site_poses(qpos, self._soles)
        # How far each corner is below its sole's center: few numbers, for which NumPy is faster.
        drop = np.abs(rotation.numpy()[..., 2, :2]) @ self._sole_half_size
        return torch.from_numpy((position.numpy()[..., 2] - drop).min(-1))
