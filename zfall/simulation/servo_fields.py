"""The fields of ``mjModel`` that make a joint's servo, for many worlds."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class ServoFields:
    """Turns factors on the nominal servos into fields ``(K, ...)`` of K worlds.

    Args:
        model: the compiled model, with the nominal values.
        joints: names of the joints, each with an actuator of its name.
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str]):
        self._dof = np.array([int(model.joint(name).dofadr[0]) for name in joints])
        self._actuator = np.array([model.actuator(name).id for name in joints])
        self._friction = model.dof_frictionloss.copy()
        self._gain, self._bias = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
        self._range = model.actuator_forcerange.copy()

    def friction(self, factor: Array, added: Array | float = 0.0) -> dict[str, Array]:
        """Dry friction: a factor ``(K, J)`` on the nominal one, and more ``(K, J)`` [N m]."""
        friction = np.repeat(self._friction[None], len(factor), 0)
        friction[:, self._dof] *= factor
        friction[:, self._dof] += added
        return {"dof_frictionloss": friction}

    def actuators(self, stiffness: Array, torque_limit: Array, zero: Array) -> dict[str, Array]:
        """Position servos.

        Args:
            stiffness: factor on torque per angle ``(K, J)``.
            torque_limit: factor on the largest torque ``(K, J)``.
            zero: what the encoder reads at angle 0 ``(K, J)`` [rad].
        """
        worlds, at = len(stiffness), self._actuator
        gain, bias, limit = (
            np.repeat(each[None], worlds, 0) for each in (self._gain, self._bias, self._range)
        )
        gain[:, at, 0] *= stiffness
        bias[:, at, 1] *= stiffness
        # The servo compares its target with what the encoder reads.
        bias[:, at, 0] = -gain[:, at, 0] * zero
        limit[:, at] *= torque_limit[..., None]
        return {
            "actuator_gainprm": gain,
            "actuator_biasprm": bias,
            "actuator_forcerange": limit,
        }
