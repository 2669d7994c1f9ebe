"""The only place that steps MuJoCo: a batch of worlds on the CPU."""

import copy
import os
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zfall.simulation.compiled import compiled, sound
from zfall.simulation.thread_pool import ThreadPool
from zfall.simulation.turns import others_turn

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_INPUT = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)
# Fields that others are derived from.
_CONSTANTS = {"body_mass", "body_inertia", "body_ipos", "dof_armature"}

CHUNKS = 32  # of worlds, for each thread: the last one at work keeps the others waiting


@compiled
def _take_over(
    state: NDArray[np.float64],
    states: NDArray[np.float64],
    rows: NDArray[np.int64],
    passed: float,
) -> NDArray[np.bool_]:
    """Copies the last of ``states`` ``(N, S, size)`` of some worlds into ``state`` ``(N, size)``.

    Returns:
        Worlds ``(N,)`` of these whose time went on by less than ``passed``: MuJoCo gave up on them.
    """
    late = np.zeros(len(state), np.bool_)
    for i in rows:
        late[i] = abs(states[i, -1, 0] - state[i, 0] - passed) > 1e-9
        state[i] = states[i, -1]
    return late


def site_poses(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: Tensor, sites: Sequence[int]
) -> tuple[Tensor, Tensor]:
    """Positions and rotations of sites, see ``Simulation.site_poses``; ``data`` is scratch."""
    position = torch.empty(len(qpos), len(sites), 3, dtype=torch.float64)
    rotation = torch.empty(len(qpos), len(sites), 9, dtype=torch.float64)
    into = zip(qpos.numpy(), position.numpy(), rotation.numpy(), strict=True)
    state_of, places, rotations = data.qpos, data.site_xpos, data.site_xmat
    index = np.asarray(sites)
    for state, place, axes in into:  # kinematics alone: some microseconds each
        state_of[:] = state
        mujoco.mj_kinematics(model, data)
        place[:], axes[:] = places[index], rotations[index]
    return position, rotation.unflatten(-1, (3, 3))


class Simulation:
    """Worlds of one MuJoCo model, stepped together by ``mujoco.rollout`` on all cores.

    Every call starts the constraint solver cold, so that the result depends on the state and the
    inputs alone: not on the number of threads, and not on what ran before.

    Args:
        model: compiled model; its timestep is the physics step.
        num_worlds: number of worlds N.
        substeps: physics steps S in one call of ``step``.
        threads: threads of the pool; all cores if ``None``.

    Attributes:
        qpos: positions ``(N, nq)`` float64, in MuJoCo's order.
        qvel: velocities ``(N, nv)`` float64.
        wrench: force and torque on each body but the world in each step of the coming call of
            ``step`` ``(N, S, nbody - 1, 6)`` float64 [N, N m; world axes, at the body's center of
            mass]; it stays as it is written.
        diverged: worlds ``(N,)`` bool whose last ``step`` MuJoCo gave up on, or that ended with a
            value not finite or beyond ``BOUND``.
    """

    def __init__(
        self, model: mujoco.MjModel, num_worlds: int, substeps: int, threads: int | None = None
    ):
        # Without this MuJoCo would put a diverged world back to its initial state and go on.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        if threads is not None and threads < 1:
            raise ValueError(f"threads must be at least 1, or null for all cores, got {threads}.")
        self.model, self.substeps = model, substeps
        self._models = [model] * num_worlds  # one object for all until set_fields
        self.threads = threads or len(os.sched_getaffinity(0))
        self._rows = np.arange(num_worlds)
        self._stepped: Tensor | None = None  # numbers of the worlds that step; None: all
        size = mujoco.mj_stateSize(model, _STATE)
        inputs = model.nu + 6 * model.nbody
        self._state = torch.zeros(num_worlds, size, dtype=torch.float64)
        self._states = torch.zeros(num_worlds, substeps, size, dtype=torch.float64)
        self._inputs = torch.zeros(num_worlds, substeps, inputs, dtype=torch.float64)
        self._sensors = torch.zeros(num_worlds, substeps, model.nsensordata, dtype=torch.float64)
        self.diverged = torch.zeros(num_worlds, dtype=torch.bool)
        self._changed: set[str] = set()  # fields that differ by world
        self._begin()

    def _begin(self) -> None:
        """Makes the threads, and the views of what they work on."""
        model = self.model
        self._pool = ThreadPool(self.threads)
        self._data = [mujoco.MjData(model) for _ in range(self.threads)]
        end = 1 + model.nq  # the state begins with the time
        self.qpos = self._state[:, 1:end]
        self.qvel = self._state[:, end : end + model.nv]
        # The world body, which comes first, keeps its zeros.
        self.wrench = self._inputs[:, :, model.nu + 6 :].unflatten(-1, (-1, 6))

    def __getstate__(self) -> dict[str, Any]:
        """For copies and pickles: of the worlds' models what differs, of the views nothing."""
        made = ("_pool", "_data", "_models", "qpos", "qvel", "wrench")
        state = {key: value for key, value in self.__dict__.items() if key not in made}
        fields = {
            name: np.stack([getattr(self._owner(model, name), name) for model in self._models])
            for name in self._changed
        }
        return state | {"fields": fields}

    def __setstate__(self, state: dict[str, Any]) -> None:
        fields = state.pop("fields")
        self.__dict__.update(state)
        self._models = [self.model] * len(self._rows)
        self._begin()
        self.set_fields(torch.ones(len(self._rows), dtype=torch.bool), fields)

    @staticmethod
    def _owner(model: mujoco.MjModel, name: str) -> Any:
        """Where a field lies: in the model, or in its options."""
        return model.opt if name == "gravity" else model

    @property
    def substates(self) -> tuple[Tensor, Tensor]:
        """Positions ``(N, S, nq)`` and velocities ``(N, S, nv)`` after each step of the last call.

        Float64 views that the next ``step`` overwrites; in rows reset since, all S are the new
        state.
        """
        end = 1 + self.model.nq
        return self._states[..., 1:end], self._states[..., end : end + self.model.nv]

    def step(self, control: Tensor) -> Tensor:
        """Takes S physics steps in every world, under the forces in ``wrench``.

        Args:
            control: actuator inputs ``(N, S, nu)``.

        Returns:
            All sensor values of the S steps ``(N, S, nsensordata)`` float64, a buffer that the
            next call overwrites. Those of step i describe the state before it and the forces in
            it. Rows that ``diverged`` are not to be used.
        """
        self._inputs[:, :, : self.model.nu] = control
        if self._stepped is None:
            self._roll(self._models, self._state, self._inputs, self._states, self._sensors)
        else:
            self._roll_some(self._stepped)
        rows = self._rows if self._stepped is None else self._stepped.numpy()
        state, passed = self._state.numpy(), self.substeps * self.model.opt.timestep
        late = _take_over(state, self._states.numpy(), rows, passed)
        good = sound(state) & sound(self._sensors[:, -1].numpy())
        self.diverged = torch.from_numpy(late | ~good)
        return self._sensors

    def step_only(self, rows: Tensor | None) -> None:
        """From now on steps the worlds in ``rows`` ``(N,)`` bool alone, or all of them again.

        The others keep their state and sensor values, and cost nothing.
        """
        self._stepped = None if rows is None else rows.nonzero()[:, 0]

    def reset(self, rows: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """Puts the worlds in ``rows`` ``(N,)`` bool into a new state.

        Args:
            rows: which worlds.
            qpos, qvel: states of those worlds ``(K, nq)`` and ``(K, nv)``.
            control: actuator inputs for which the sensors are computed ``(K, nu)``.

        Returns:
            Sensor values as from ``step``, where all S entries of a row in ``rows`` hold the
            values of its new state, and the other rows are as the last ``step`` left them.
        """
        self.diverged = self.diverged & ~rows
        index = rows.nonzero()[:, 0]
        state = self._full_state(qpos, qvel)
        self._state[index], self._states[index] = state, state[:, None]
        self._sensors[index] = self._sensors_of(qpos, qvel, control, index)[:, None]
        return self._sensors

    def set_fields(self, rows: Tensor, fields: dict[str, NDArray[np.float64]]) -> None:
        """Gives each world in ``rows`` ``(N,)`` bool its own model, with other values.

        What MuJoCo derives from masses and inertias is computed anew.

        Args:
            rows: which worlds.
            fields: by name of a field of ``mjModel`` (or ``gravity``), values of those worlds
                ``(K, *shape of the field)``.
        """
        if not fields:
            return
        if self._models[0] is self.model:
            self._models = [copy.copy(self.model) for _ in self._models]
        self._changed |= fields.keys()
        derive = not _CONSTANTS.isdisjoint(fields)
        changed = [self._models[row] for row in rows.nonzero()[:, 0].tolist()]
        for k, model in enumerate(changed):
            for name, value in fields.items():
                getattr(self._owner(model, name), name)[:] = value[k]
            if derive:
                mujoco.mj_setConst(model, self._data[0])

    def model_of(self, world: int) -> mujoco.MjModel:
        """The model of a world, with the fields that are its own."""
        return self._models[world]

    def site_poses(self, qpos: Tensor, sites: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Positions ``(K, n, 3)`` [m] and rotation matrices ``(K, n, 3, 3)`` of n sites.

        Args:
            qpos: any states ``(K, nq)`` float64.
            sites: numbers of the sites in the model.
        """
        return site_poses(self.model, self._data[0], qpos, sites)

    def _sensors_of(self, qpos: Tensor, qvel: Tensor, control: Tensor, index: Tensor) -> Tensor:
        """Sensor values ``(K, nsensordata)`` of new states of the worlds in ``index``."""
        # A loop, for these are few rows between two steps: threads would take longer to wake up.
        data = self._data[0]
        sensors = torch.empty(len(qpos), self.model.nsensordata, dtype=torch.float64)
        data.time, data.xfrc_applied[:] = 0.0, 0.0
        arrays = (data.qpos, data.qvel, data.ctrl, data.qacc_warmstart, data.sensordata)
        place_of, speed_of, target_of, start_of, read = arrays  # MuJoCo makes a view each time
        states = zip(qpos.numpy(), qvel.numpy(), control.numpy(), sensors.numpy(), strict=True)
        for row, (position, velocity, target, values) in zip(index.tolist(), states, strict=True):
            place_of[:], speed_of[:], target_of[:] = position, velocity, target
            start_of[:] = 0.0
            mujoco.mj_forward(self._models[row], data)
            values[:] = read
        return sensors

    def _full_state(self, qpos: Tensor, qvel: Tensor) -> Tensor:
        state = torch.zeros(len(qpos), self._state.shape[1], dtype=torch.float64)
        end = 1 + self.model.nq
        state[:, 1:end] = qpos
        state[:, end : end + self.model.nv] = qvel
        return state

    def _roll(
        self,
        models: list[mujoco.MjModel],
        state: Tensor,
        inputs: Tensor,
        states: Tensor,
        sensors: Tensor,
    ) -> None:
        arrays = (state.numpy(), inputs.numpy())
        with others_turn():  # most of it without Python's lock
            self._pool.rollout(
                models,
                self._data,
                *arrays,
                control_spec=_INPUT,
                skip_checks=True,
                chunk_size=max(1, len(state) // (CHUNKS * self.threads)),
                nstep=inputs.shape[1],
                state=states.numpy(),
                sensordata=sensors.numpy(),
            )

    def _roll_some(self, rows: Tensor) -> None:
        """Steps a few worlds, in copies of their rows."""
        if not len(rows):
            return
        states, sensors = self._states[rows], self._sensors[rows]
        models = [self._models[row] for row in rows.tolist()]
        self._roll(models, self._state[rows], self._inputs[rows], states, sensors)
        self._states[rows], self._sensors[rows] = states, sensors

    def state_dict(self) -> dict[str, Tensor]:
        """Everything that ``step`` depends on."""
        return {"state": self._state.clone(), "sensors": self._sensors.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restores what ``state_dict`` gave."""
        self._state.copy_(state["state"])
        self._sensors.copy_(state["sensors"])
