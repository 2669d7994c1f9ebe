"""Forces that act in the coming control step."""

import torch
from torch import Tensor

from zfall.envs.control import check_shape


class StepForces:
    """Fills the simulation's buffer of wrenches and remembers which rows may not be 0.

    All of the buffer ``(N, S, bodies, 6)`` would take many times as long to clear as the few rows
    that a push writes.

    Args:
        num_envs: number of worlds N.
    """

    def __init__(self, num_envs: int):
        self._worlds = torch.arange(num_envs)
        self._written: list[tuple[Tensor, int | Tensor | slice]] = []  # worlds and their bodies

    def take(self, wrench: Tensor, value: Tensor | None) -> None:
        """Writes what acts in the coming step, nothing if ``None``.

        Args:
            wrench: the simulation's buffer ``(N, S, bodies, 6)`` [N, N m; world axes].
            value: what a TensorDict holds; if it is the buffer itself, all is there already.

        Raises:
            ValueError: if it has another shape.
        """
        if value is wrench:
            return
        if value is not None:
            check_shape("push.wrench", value, tuple(wrench.shape))
            wrench.copy_(value)
            self._written = [(self._worlds, slice(None))]
            return
        for rows, target in self._written:
            wrench[rows, :, target] = 0.0
        self._written = []

    def add(
        self, wrench: Tensor, target: int | Tensor, force: Tensor, rows: Tensor | None = None
    ) -> None:
        """Adds a force to what the buffer has; arguments as ``HumanoidEnv.add_force``."""
        index = self._worlds if rows is None else rows
        wrench[index, :, target, :3] += force
        self._written.append((index, target))
