"""The state of a ball: launches it, and reads where it is."""

from collections.abc import Sequence

import mujoco
from tensordict import TensorDictBase
from torch import Tensor

from zfall.simulation.cpu import Simulation


class BallState:
    """Position and velocity of the ball in MuJoCo's state.

    Args:
        model: the compiled model, with a free joint ``ball``.
    """

    def __init__(self, model: mujoco.MjModel):
        joint = model.joint("ball")
        place, speed = int(joint.qposadr[0]), int(joint.dofadr[0])
        self._place, self._speed = slice(place, place + 3), slice(speed, speed + 3)
        self._spin = slice(speed + 3, speed + 6)

    def launch(self, simulation: Simulation, tensordict: TensorDictBase) -> None:
        """Puts the balls of worlds with ``("ball", "launch")`` to ``("ball", "start")``."""
        launch = tensordict.get(("ball", "launch"), None)
        if launch is not None and launch.any():
            rows = launch[:, 0]
            start = tensordict["ball", "start"][rows].double()
            simulation.qpos[rows, self._place] = start[:, :3]
            simulation.qvel[rows, self._speed] = start[:, 3:]
            simulation.qvel[rows, self._spin] = 0.0  # what the last throw left

    def read(self, states: Sequence[Tensor]) -> dict[tuple[str, ...], Tensor]:
        """``("ball", "position")`` and ``("ball", "velocity")`` ``(K, 3)`` float32.

        Args:
            states: positions ``(K, nq)`` and velocities ``(K, nv)`` of all bodies.
        """
        qpos, qvel = states
        return {
            ("ball", "position"): qpos[:, self._place].float(),
            ("ball", "velocity"): qvel[:, self._speed].float(),
        }
