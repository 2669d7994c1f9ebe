"""The robot in dm_control's ``Physics``: quantities by name, and the step of a task."""

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from dm_control import mujoco as dm_mujoco
from numpy.typing import NDArray
from torch import Tensor

from zfall.robots import DEFAULT, Robot
from zfall.simulation.compiled import sound

Array = NDArray[np.float64]
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


class Physics(dm_mujoco.Physics):
    """The robot's model and data, with the quantities of ``HumanoidEnv`` by name (float64).

    Positions and velocities are those of the present state; ``feet_contact`` is that of the last
    physics step.

    Attributes:
        robot: gives the names of joints and feet.
    """

    robot: Robot = DEFAULT
    _control_step: Callable[[], None] | None = None

    def at_next_step(self, control_step: Callable[[], None]) -> None:
        """Lets ``control_step`` take the physics steps of the next call of ``step``."""
        self._control_step = control_step

    def step(self, nstep: int = 1) -> None:
        """Takes the control step planned, or else ``nstep`` plain physics steps."""
        if self._control_step is None:
            super().step(nstep)
        else:
            control_step, self._control_step = self._control_step, None
            control_step()

    def copy(self, share_model: bool = False) -> "Physics":
        """Another instance in the same state."""
        new = super().copy(share_model)
        new.robot = self.robot
        return new

    def __getstate__(self) -> Any:
        return super().__getstate__(), self.robot

    def __setstate__(self, state: Any) -> None:
        data, self.robot = state
        super().__setstate__(data)

    def joint_position(self) -> Array:
        """Joint angles ``(J,)`` [rad]."""
        return self.named.data.qpos[list(self.robot.joints)].copy()

    def joint_velocity(self) -> Array:
        """Joint speeds ``(J,)`` [rad/s]."""
        return self.named.data.qvel[list(self.robot.joints)].copy()

    def base_position(self) -> Array:
        """``(3,)`` [m; world]."""
        return self.data.qpos[:3].copy()

    def base_orientation(self) -> Array:
        """``(4,)`` (w, x, y, z), body to world."""
        return self.data.qpos[3:7].copy()

    def base_linear_velocity(self) -> Array:
        """``(3,)`` [m/s; world]."""
        return self.data.qvel[:3].copy()

    def base_angular_velocity(self) -> Array:
        """``(3,)`` [rad/s; body]."""
        return self.data.qvel[3:6].copy()

    def projected_gravity(self) -> Array:
        """Direction of gravity in the axes of the base, a unit vector ``(3,)``."""
        gravity, inverse, down = self.model.opt.gravity, np.empty(4), np.empty(3)
        mujoco.mju_negQuat(inverse, self.data.qpos[3:7])
        mujoco.mju_rotVecQuat(down, gravity / np.linalg.norm(gravity), inverse)
        return down

    def com_position(self) -> Array:
        """Center of mass ``(3,)`` [m; world]."""
        return self._sensor("com_position")

    def com_velocity(self) -> Array:
        """``(3,)`` [m/s; world]."""
        return self._sensor("com_velocity")

    def feet_position(self) -> Array:
        """Center of the sole, left and right ``(2, 3)`` [m; world]."""
        return np.stack([self._sensor(f"feet_position/{foot}") for foot in self.robot.feet])

    def feet_contact(self) -> NDArray[np.bool_]:
        """Whether the left and the right foot touch the floor ``(2,)``."""
        found = [self._sensor(f"feet_contact/{foot}")[0] for foot in self.robot.feet]
        return np.array(found) > 0

    def _sensor(self, name: str) -> Array:
        return self.named.data.sensordata[name].copy()


class PhysicsSimulation:
    """One world with the interface of ``Simulation``, stepped by ``mj_step`` in a ``Physics``.

    Its state is that of the physics and nowhere else: what ``physics.set_state`` or a wrapper of
    dm_control changes, counts. Forces found in ``xfrc_applied``, the viewer's mouse for instance,
    act in addition to the wrench and stay there.

    Args:
        physics: whose model and data are stepped.
        substeps: physics steps S in one call of ``step``.

    Attributes:
        wrench: what acts in the coming call of ``step``; see ``Simulation``.
    """

    def __init__(self, physics: Physics, substeps: int):
        self.physics, self.substeps = physics, substeps
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._sensors = torch.zeros(1, substeps, self.model.nsensordata, dtype=torch.float64)
        self.wrench = torch.zeros(1, substeps, self.model.nbody - 1, 6, dtype=torch.float64)
        self.diverged = torch.zeros(1, dtype=torch.bool)
        self.substates = tuple(
            torch.zeros(1, substeps, size, dtype=torch.float64)
            for size in (self.model.nq, self.model.nv)
        )

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self.physics.model.ptr

    @property
    def qpos(self) -> Tensor:
        """Positions ``(1, nq)`` float64, in MuJoCo's order."""
        return torch.from_numpy(self.physics.data.qpos)[None]

    @property
    def qvel(self) -> Tensor:
        """Velocities ``(1, nv)`` float64."""
        return torch.from_numpy(self.physics.data.qvel)[None]

    def field(self, name: str) -> NDArray[np.float64]:
        """Values of a field of ``mjModel`` ``(1, *shape of the field)``."""
        value: NDArray[np.float64] = getattr(self.model, name)
        return value[None]

    def step(self, control: Tensor) -> Tensor:
        """Takes S physics steps; see ``Simulation.step``."""
        model, data = self.model, self.physics.data.ptr
        controls, sensors = control[0].numpy(), self._sensors[0].numpy()
        wrenches = self.wrench[0].numpy()
        by_hand, warnings = data.xfrc_applied.copy(), data.warning.number.sum()
        data.qacc_warmstart[:] = 0.0  # each control step starts the solver cold, as there
        done = 0
        while done < self.substeps and data.warning.number.sum() == warnings:
            data.ctrl[:] = controls[done]
            data.xfrc_applied[1:] = by_hand[1:] + wrenches[done]
            mujoco.mj_step(model, data)
            sensors[done] = data.sensordata
            self._keep_substate(done)
            done += 1
        data.xfrc_applied[:] = by_hand
        good = sound(np.concatenate([sensors[-1], data.qpos, data.qvel])[None])
        self.diverged = torch.from_numpy(~good) | (done < self.substeps)
        mujoco.mj_step1(model, data)  # what depends on position and velocity, up to date
        return self._sensors

    def reset(self, rows: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """Puts the world into a new state if it is in ``rows``; see ``Simulation.reset``."""
        if rows.any():
            data = self.physics.data.ptr
            self._forward(data, qpos[0], qvel[0], control[0])
            self._sensors[:] = torch.from_numpy(data.sensordata)
            self._keep_substate(slice(None))
        self.diverged = self.diverged & ~rows
        return self._sensors

    def _keep_substate(self, step: int | slice) -> None:
        """Writes the present state into ``substates``, see ``Simulation.substates``."""
        for states, now in zip(self.substates, (self.qpos, self.qvel), strict=True):
            states[:, step] = now if isinstance(step, int) else now[:, None]

    def set_fields(self, rows: Tensor, fields: dict[str, NDArray[np.float64]]) -> None:
        """Changes fields of the physics' model; see ``Simulation.set_fields``."""
        if rows.any() and fields:
            for name, value in fields.items():
                owner = self.model.opt if name == "gravity" else self.model
                getattr(owner, name)[:] = value[0]
            mujoco.mj_setConst(self.model, mujoco.MjData(self.model))

    def site_poses(self, qpos: Tensor, sites: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Positions and rotations of sites; see ``Simulation.site_poses``."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = qpos[0]
        mujoco.mj_kinematics(self.model, data)
        position, rotation = data.site_xpos[list(sites)], data.site_xmat[list(sites)]
        return torch.from_numpy(position)[None], torch.from_numpy(rotation).reshape(1, -1, 3, 3)

    def _forward(self, data: mujoco.MjData, qpos: Tensor, qvel: Tensor, control: Tensor) -> None:
        mujoco.mj_resetData(self.model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, control
        mujoco.mj_forward(self.model, data)

    def state_dict(self) -> dict[str, Tensor]:
        """Everything that ``step`` depends on."""
        state = self.physics.get_state(_STATE)
        return {"state": torch.from_numpy(state)[None], "sensors": self._sensors.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restores what ``state_dict`` gave."""
        self.physics.set_state(state["state"][0].numpy(), _STATE)
        self._sensors.copy_(state["sensors"])
