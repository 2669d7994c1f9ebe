"""The only place that steps MuJoCo: a batch of worlds on the CPU."""

import copy
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray
from torch import Tensor

from zfall.cores import usable_cores
from zfall.simulation.compiled import sound
from zfall.simulation.forks import begin_again_in_forks
from zfall.simulation.turns import others_turn

_STATE = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
_INPUT = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)
# Fields that others are derived from.
_CONSTANTS = {"body_mass", "body_inertia", "body_ipos", "dof_armature"}


class Simulation:
    """Worlds of one MuJoCo model, stepped together by ``mujoco.batch`` on all cores.

    Every call starts the constraint solver cold, so that the result depends on the state and the
    inputs alone: not on the number of threads, and not on what ran before.

    Args:
        model: compiled model; its timestep is the physics step. What is changed in it counts
            until the first call of ``set_fields``.
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
        self.model, self.num_worlds, self.substeps = model, num_worlds, substeps
        self.threads = threads or usable_cores()
        self._stepped: NDArray[np.int32] | None = None  # the worlds that step; None: all
        self._fields: dict[str, NDArray[np.float64]] = {}  # that differ by world (N, ...)
        size = mujoco.mj_stateSize(model, _STATE)
        inputs = model.nu + 6 * model.nbody
        self._states = torch.zeros(num_worlds, substeps, size, dtype=torch.float64)
        self._inputs = torch.zeros(num_worlds, substeps, inputs, dtype=torch.float64)
        self._sensors = torch.zeros(num_worlds, substeps, model.nsensordata, dtype=torch.float64)
        self.diverged = torch.zeros(num_worlds, dtype=torch.bool)
        self._begin()
        self._batch.set_models(model)  # as it is, and not a copy of what it was
        begin_again_in_forks(self)

    def _begin(self) -> None:
        """Makes the batch, and the views of what it works on."""
        model = self.model
        self._batch = Batch(model, self.num_worlds, self.threads)
        still = copy.copy(model)  # for the poses of states that no world is in
        still.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self._poses = Batch(still, self.num_worlds, 1)
        self._all = torch.from_numpy(self._batch.state)
        self._state = self._all[:, : self._states.shape[-1]]
        self._warm_start = self._batch.bind("qacc_warmstart")
        self._control = torch.from_numpy(self._batch.bind("ctrl"))
        self._now = self._batch.bind("sensordata")  # of the last call
        end = 1 + model.nq  # the state begins with the time
        self.qpos = self._state[:, 1:end]
        self.qvel = self._state[:, end : end + model.nv]
        # The world body, which comes first, keeps its zeros.
        self.wrench = self._inputs[:, :, model.nu + 6 :].unflatten(-1, (-1, 6))

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
        self._warm_start[:] = 0.0
        before, rows = self._state[:, 0].clone(), self._stepped
        failed = torch.zeros(self.num_worlds, dtype=torch.bool)
        try:
            if rows is None:
                self._roll(None, self._inputs, self._states, self._sensors)
            elif len(rows):  # in copies of their rows
                states, sensors = self._states[rows], self._sensors[rows]
                self._roll(rows, self._inputs[rows], states, sensors)
                self._states[rows], self._sensors[rows] = states, sensors
        except SimulationError as error:  # the others ran to the end
            failed[error.ids] = True
        passed = self._state[:, 0] - before  # less where MuJoCo gave up
        late = (passed - self.substeps * self.model.opt.timestep).abs() > 1e-9
        if rows is not None:
            late &= torch.zeros_like(late).index_fill(0, torch.from_numpy(rows).long(), True)
        good = sound(self._state.numpy()) & sound(self._sensors[:, -1].numpy())
        self.diverged = late | failed | ~torch.from_numpy(good)
        return self._sensors

    def step_only(self, rows: Tensor | None) -> None:
        """From now on steps the worlds in ``rows`` ``(N,)`` bool alone, or all of them again.

        The others keep their state and sensor values, and cost nothing.
        """
        self._stepped = None if rows is None else rows.numpy().nonzero()[0].astype(np.int32)

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
        if not len(index):
            return self._sensors
        self._all[index] = 0.0
        self.qpos[index], self.qvel[index] = qpos.double(), qvel.double()
        self._control[index] = control.double()
        self._batch.forward(rows.numpy())
        self._states[index] = self._state[index][:, None]
        self._sensors[index] = torch.from_numpy(self._now[rows.numpy()])[:, None]
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
        if not self._fields:  # from here on with fields of its own
            state = self._all.clone()
            self._begin()
            self._all.copy_(state)
        which = rows.numpy()
        for name, value in fields.items():
            if name not in self._fields:
                field = "opt.gravity" if name == "gravity" else name
                self._fields[name] = self._batch.expand(field)
            self._fields[name][which] = value
        if not _CONSTANTS.isdisjoint(fields):
            self._batch.set_const(which)

    def field(self, name: str) -> NDArray[np.float64]:
        """Values of a field of ``mjModel`` in all worlds ``(N, *shape of the field)``."""
        if name in self._fields:
            return self._fields[name]
        value: NDArray[np.float64] = getattr(self.model, name)
        return np.broadcast_to(value, (self.num_worlds, *value.shape))

    def model_of(self, world: int) -> mujoco.MjModel:
        """A copy of the model, with the fields of a world."""
        return self._batch.get_model(world)

    def site_poses(self, qpos: Tensor, sites: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Positions ``(K, n, 3)`` [m] and rotation matrices ``(K, n, 3, 3)`` of n sites.

        Args:
            qpos: any states ``(K, nq)`` float64, not more than there are worlds.
            sites: numbers of the sites in the model.
        """
        count, index = len(qpos), np.asarray(sites)
        self._poses.qpos[:count] = qpos.numpy()
        places, axes = self._poses.site_xpos, self._poses.site_xmat
        self._poses.forward(np.arange(count), int(mujoco.mjtStage.mjSTAGE_POS))
        position = torch.from_numpy(places[:count, index])
        rotation = torch.from_numpy(axes[:count, index])
        return position, rotation.unflatten(-1, (3, 3))

    def _roll(
        self,
        rows: NDArray[np.int32] | None,
        inputs: Tensor,
        states: Tensor,
        sensors: Tensor,
    ) -> None:
        """Takes the steps of some worlds, or of all; writes what they gave ``(K, S, ...)``."""
        with others_turn():  # most of it without Python's lock
            self._batch.rollout(
                inputs.shape[1],
                inputs.numpy(),
                _INPUT,
                record=(_STATE, "sensordata"),
                ids=rows,
                out={_STATE: states.numpy(), "sensordata": sensors.numpy()},
            )

    def __getstate__(self) -> dict[str, Any]:
        """For copies and pickles: all but the batch and its views."""
        made = ("_batch", "_poses", "_all", "_state", "_warm_start", "_control", "_now")
        views = (*made, "qpos", "qvel", "wrench")
        kept = {key: value for key, value in self.__dict__.items() if key not in views}
        fields = {name: value.copy() for name, value in self._fields.items()}
        return kept | {"_fields": fields, "whole": self._all.numpy().copy()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        whole, fields = state.pop("whole"), state.pop("_fields")
        self.__dict__.update(state, _fields={})
        self._begin()
        if fields:
            self.set_fields(torch.ones(self.num_worlds, dtype=torch.bool), fields)
        else:
            self._batch.set_models(self.model)
        self._all.numpy()[:] = whole
        begin_again_in_forks(self)

    def begin_again(self) -> list[Any]:
        """In a forked process: the same with new threads; returns what must not be freed there."""
        lost = [self._batch._b]
        self.__setstate__(self.__getstate__())
        return lost

    def state_dict(self) -> dict[str, Tensor]:
        """Everything that ``step`` depends on."""
        return {"state": self._state.clone(), "sensors": self._sensors.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restores what ``state_dict`` gave."""
        self._state.copy_(state["state"])
        self._sensors.copy_(state["sensors"])
