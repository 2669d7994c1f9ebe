"""The base env: named physical quantities out, servo targets and forces in."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.transforms.utils import _get_reset

from zfall.robots import ZEROTH01, PushPoint, Robot
from zfall.simulation.cpu import Simulation, sound
from zfall.simulation.model import (
    Ball,
    compile_model,
    push_targets,
    sensor_slices,
    servo_time_constant,
)
from zfall.simulation.parameters import PhysicsParameters
from zfall.simulation.quantities import PEAK_KEYS, SUBSTEP_KEYS, Quantities
from zfall.simulation.specs import action_spec, done_spec, observation_spec

STATE_KEYS = (  # what a state of the robot is made of
    "joint_position",
    "joint_velocity",
    "base_position",
    "base_orientation",
    "base_linear_velocity",
    "base_angular_velocity",
)
START_KEYS = (*STATE_KEYS, "clearance")


class HumanoidEnv(EnvBase):
    """A batch of humanoids on a flat floor, with no task.

    Reads ``control``, servo targets ``(N, S, J)`` [rad] for each of the S physics steps of a
    control step; if that key is absent, ``target`` ``(N, J)``, held for the whole step. Reads
    ``("push", "wrench")`` ``(N, S, bodies, 6)`` [N, N m; world axes] if present; ``push_targets``
    gives the index of each link and push point. Two keys change the state before the step, if
    present: ``("push", "kick")`` ``(N, 3)`` [m/s; world] is added to the base's velocity,
    and ``("ball", "launch")`` ``(N, 1)`` says where the ball is put to ``("ball", "start")``.

    Writes the keys below (float32). Positions and velocities of joints and base are those at
    the end of the step. Whatever else comes from MJCF sensors (com, feet, momentum) is one
    physics step older, as MuJoCo computes it; after a reset it is that of the new state.

    ======================== ========= ==============================================
    key                      shape     content
    ======================== ========= ==============================================
    joint_position           J         [rad]
    joint_velocity           J         [rad/s]
    joint_torque             J         of the servos, mean over the step [N m]
    joint_torque_peak        1         largest of any joint over the step [N m]
    base_position            3         [m; world]
    base_orientation         4         (w, x, y, z), body to world
    projected_gravity        3         direction of gravity in body axes, a unit vector
    base_linear_velocity     3         [m/s; world]
    base_angular_velocity    3         the gyro [rad/s; body]
    base_acceleration        3         the accelerometer, mean over the step [m/s2; body]
    base_acceleration_peak   1         largest norm of it over the step [m/s2], 9.81 at rest
    com_position             3         [m; world]
    com_velocity             3         [m/s; world]
    linear_momentum          3         [kg m/s; world]
    angular_momentum         3         about the center of mass [kg m2/s; world]
    feet_position            2 x 3     center of the sole, left and right [m; world]
    feet_orientation         2 x 4     (w, x, y, z), sole to world
    feet_velocity            2 x 3     of the center of the sole [m/s; world]
    feet_force               2 x 3     of the floor on the foot, last physics step [N; world]
    feet_cop                 2 x 2     center of pressure [m; sole], 0 without force
    feet_corner_force        2 x 4     vertical, last physics step [N]
    feet_contact             2         bool, at the last physics step
    contact_force_peak       R         norm of the floor's force on each of ``regions``,
                                       largest over the step [N]
    contact_impulse          R         that norm, integrated over the step [N s]
    diverged                 1         bool, the physics failed; the world has terminated
    ("ball", "position")     3         its center, if there is a ball [m; world]
    ("ball", "velocity")     3         [m/s; world]
    ======================== ========= ==============================================

    ``reset`` puts worlds into the standing pose, or into what the keys ``("start", NAME)`` of
    its TensorDict say, NAME being one of ``START_KEYS``. Without ``("start", "base_position")``,
    or where it is not a number, the lowest corner of the soles is put on the floor, or
    ``("start", "clearance")`` ``(N, 1)`` [m] above it. A task's env, as ``make_env`` builds it,
    is started by its transforms, ``ScriptedStart`` for instance: TorchRL hands it nothing else.

    After ``record_substeps(keys)`` it also writes ``("substeps", key)`` ``(N, S, ...)``.

    Args:
        num_envs: number of worlds N.
        control_dt: time between two actions [s], a multiple of ``physics_dt``.
        physics_dt: timestep of the physics [s].
        robot: the robot.
        push_points: points for pushes besides the robot's own, by name.
        ball: a ball that ``ThrownBall`` can throw.
        servos: whether the servos act at all; without them the robot is limp.
        threads: threads for the physics; all cores if ``None``.

    Raises:
        ValueError: on a bad number of worlds or time step, or an MJCF that lacks something.
    """

    _has_frame_skip = True  # substeps are ours: keeps TorchRL from wrapping the env
    batch_locked = True

    def __init__(
        self,
        *,
        num_envs: int,
        control_dt: float,
        physics_dt: float = 0.004,
        robot: Robot = ZEROTH01,
        push_points: dict[str, PushPoint] | None = None,
        ball: Ball | None = None,
        servos: bool = True,
        threads: int | None = None,
    ):
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, got {num_envs}.")
        for name, value in (("physics_dt", physics_dt), ("control_dt", control_dt)):
            if not 0 < value < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {value}.")
        substeps = round(control_dt / physics_dt)
        if substeps < 1 or abs(substeps * physics_dt - control_dt) > 1e-9:
            raise ValueError(
                f"control_dt must be a multiple of physics_dt, got control_dt {control_dt} with "
                f"physics_dt {physics_dt}; {max(substeps, 1) * physics_dt:g} would be."
            )
        super().__init__(device=None, batch_size=[num_envs])  # with one, each step checks all keys
        self.robot, self.num_envs, self.substeps = robot, num_envs, substeps
        self.control_dt, self.physics_dt = control_dt, physics_dt
        self.regions = robot.regions
        self.ball = ball
        model = compile_model(
            robot, physics_dt=physics_dt, push_points=push_points, ball=ball, servos=servos
        )
        self.simulation = Simulation(model, num_envs, substeps, threads)
        self.push_targets = push_targets(model)
        self.num_bodies = model.nbody - 1
        self.mass = float(model.body_mass.sum()) - (ball.mass if ball else 0.0)
        self.parameters = PhysicsParameters(model, robot, num_envs)
        self.rng = torch.Generator()
        joints = [model.joint(name) for name in robot.joints]
        self.joint_range = torch.from_numpy(np.stack([j.range for j in joints])).float()
        self.stand_position = torch.tensor(robot.stand_position)
        self._soles = [int(model.sensor(f"feet_position/{foot}").objid[0]) for foot in robot.feet]
        self.servo_time_constant = servo_time_constant(model, robot)
        self._recorded: tuple[str, ...] = ()
        self._observed: dict[NestedKey, Tensor] | None = None  # what the last step or reset gave
        # Of the last partial reset: what was there, what took its place, and its version then.
        self._merged: list[tuple[Tensor, Tensor, int]] = []
        self._stand = torch.tensor(model.key("stand").qpos.copy())
        self._quantities = Quantities(
            robot,
            sensor_slices(model),
            torch.tensor([int(j.qposadr[0]) for j in joints]),
            torch.tensor([int(j.dofadr[0]) for j in joints]),
            self.mass,
            control_dt,
        )
        # Joints in the order of the model's actuators, if that is another one.
        order = [robot.joints.index(model.actuator(i).name) for i in range(model.nu)]
        self._to_actuators = slice(None) if order == sorted(order) else torch.tensor(order)
        self._stand_control = self.stand_position.double()[self._to_actuators]
        self._worlds = torch.arange(num_envs)
        # Worlds and their bodies whose wrench may not be 0.
        self._pushed: list[tuple[Tensor, int | Tensor | slice]] = []
        places = (0, 0)  # where the ball's state begins in positions and velocities
        if ball:
            joint = model.joint("ball")
            places = (int(joint.qposadr[0]), int(joint.dofadr[0]))
        self._ball = tuple(slice(place, place + 3) for place in places)
        self.observation_spec = observation_spec(robot, num_envs, with_ball=ball is not None)
        self.full_action_spec = action_spec(self.joint_range, num_envs, substeps)
        self.full_reward_spec = Composite(shape=(num_envs,))  # a task's transforms give the reward
        self.full_done_spec = done_spec(num_envs)
        self.set_seed(0)

    def push_target(self, point: str) -> int:
        """Index of a link or push point among the bodies of a wrench.

        Raises:
            ValueError: if there is none of this name.
        """
        if point not in self.push_targets:
            raise ValueError(
                f"point must be a push point or a link, one of {', '.join(self.push_targets)}; "
                f"got {point!r}."
            )
        return self.push_targets[point]

    def add_force(
        self,
        tensordict: TensorDictBase,
        target: int | Tensor,
        force: Tensor,
        rows: Tensor | None = None,
    ) -> TensorDictBase:
        """Lets a force act in the coming step, besides what ``("push", "wrench")`` holds already.

        Args:
            tensordict: of the step. It then holds the sum, in a buffer lent for this step.
            target: what it acts on, as from ``push_target``; of each world ``(K,)`` or of all.
            force: in each physics step ``(K, S, 3)`` [N; world].
            rows: the worlds that it acts in ``(K,)``, each once; all N if ``None``.
        """
        wrench = self.simulation.wrench
        there = tensordict.get(("push", "wrench"), None)
        if there is not wrench:
            self._set_wrench(there)
            tensordict["push", "wrench"] = wrench
        index = self._worlds if rows is None else rows
        wrench[index, :, target, :3] += force
        self._pushed.append((index, target))
        return tensordict

    def _set_wrench(self, value: Tensor | None) -> None:
        """Writes what acts in the coming step ``(N, S, bodies, 6)``, nothing if ``None``."""
        wrench = self.simulation.wrench
        if value is not None:
            wrench.copy_(value)
            self._pushed = [(self._worlds, slice(None))]
            return
        for index, target in self._pushed:  # all of it would take many times as long
            wrench[index, :, target] = 0.0
        self._pushed = []

    def record_substeps(self, keys: Iterable[str]) -> None:
        """Makes the env also write what ``keys`` are after each of the S physics steps.

        ``("substeps", key)`` ``(N, S, ...)``: entry s is the value after physics step s, so that
        the last one is ``key`` itself (but for ``base_acceleration`` and ``joint_torque``, which
        are means over the step); after a reset all are those of the new state. To be called before
        transforms wrap the env.

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
        self._recorded = tuple(dict.fromkeys((*self._recorded, *keys)))
        self._observed = None
        spec = self.observation_spec.clone()
        for key in keys:
            num, *shape = spec[key].shape
            spec["substeps", key] = Unbounded((num, self.substeps, *shape))
        self.observation_spec = spec

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        control = tensordict.get("control", None)
        if control is None:
            control = tensordict["target"][:, None].expand(-1, self.substeps, -1)
        wrench = tensordict.get(("push", "wrench"), None)
        if wrench is not self.simulation.wrench:
            self._set_wrench(wrench)
        self._disturb(tensordict)
        sensors = self.simulation.step(control[..., self._to_actuators])
        observed = self._observe(sensors)
        diverged = self.simulation.diverged
        for key in PEAK_KEYS:  # of what is in between
            diverged = diverged | torch.from_numpy(~sound(observed[key].numpy()))
        if diverged.any():  # such a world ends here, in a state the learner can read
            observed = self._observe(self._place(diverged, {}))
        return self._mark(observed, diverged[:, None])

    def _disturb(self, tensordict: TensorDictBase) -> None:
        """Changes states at once, before the step: kicks and balls."""
        kick = tensordict.get(("push", "kick"), None)
        if kick is not None:
            self.simulation.qvel[:, :3] += kick
        launch = tensordict.get(("ball", "launch"), None)
        if launch is not None and launch.any():
            rows, (places, speeds) = launch[:, 0], self._ball
            start = tensordict["ball", "start"][rows].double()
            self.simulation.qpos[rows, places] = start[:, :3]
            self.simulation.qvel[rows, speeds] = start[:, 3:]
            spin = slice(speeds.stop, speeds.stop + 3)  # what the last throw left
            self.simulation.qvel[rows, spin] = 0.0

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        source = TensorDict(batch_size=self.batch_size) if tensordict is None else tensordict
        before, self._merged = self._observed, []
        rows = _get_reset("_reset", source).reshape(self.num_envs)
        start = {
            key: source["start", key] for key in START_KEYS if ("start", key) in source.keys(True)
        }
        sensors = self._place(rows, start)
        if before is None or rows.all():
            observed = self._observe(sensors)
        else:  # a few new rows among what the others had
            index = rows.nonzero()[:, 0]
            observed = self._observe(sensors, index, before)
            if not torch.is_inference_mode_enabled():  # there tensors have no version
                pairs = zip(before.values(), observed.values(), strict=True)
                self._merged = [(old, now, now._version) for old, now in pairs]
        return self._mark(observed, torch.zeros(self.num_envs, 1, dtype=torch.bool))

    def merged(self) -> dict[int, Tensor]:
        """What the last partial reset gave in place of what was there, by ``id`` of the latter.

        Rows that were not reset are equal in both, so that nothing needs to be put together of
        them. What has been written to since is left out, as far as torch counts it: not what was
        written through ``.data`` or ``.numpy()``. Valid until the next step or reset.
        """
        return {id(old): now for old, now, version in self._merged if now._version == version}

    def _observe(
        self,
        sensors: Tensor,
        index: Tensor | None = None,
        before: dict[NestedKey, Tensor] | None = None,
    ) -> dict[NestedKey, Tensor]:
        """All quantities; of the worlds that are not in ``index`` ``(K,)`` as they were before."""
        simulation, parameters = self.simulation, self.parameters
        states = (simulation.qpos, simulation.qvel)
        out = self._quantities(
            *states, sensors, parameters.gravity, parameters.mass, index=index, before=before
        )
        new: dict[NestedKey, Tensor] = {
            ("substeps", key): value for key, value in self._substeps(sensors, index).items()
        }
        if self.ball:
            for name, state, columns in zip(
                ("position", "velocity"), _rows_of(states, index), self._ball, strict=True
            ):
                new["ball", name] = state[:, columns].float()
        if index is not None and before is not None:
            new = {key: before[key].index_copy(0, index, value) for key, value in new.items()}
        return out | new

    def _mark(self, observed: dict[NestedKey, Tensor], diverged: Tensor) -> TensorDictBase:
        """Keeps what was observed and adds the flags: only failed physics ends an episode."""
        self._observed = observed
        flags = {key: diverged.clone() for key in ("diverged", "terminated", "done")}
        flags["truncated"] = torch.zeros_like(diverged)
        flat = {key: value for key, value in observed.items() if isinstance(key, str)}
        # Without the checks of each value, whose shapes are known: they take longer than the rest.
        out = TensorDict._new_unsafe(flat | flags, batch_size=self.batch_size)
        for key, value in observed.items():
            if key not in flat:
                out[key] = value
        return out

    def _substeps(self, sensors: Tensor, index: Tensor | None) -> dict[str, Tensor]:
        """What ``record_substeps`` asked for, of the worlds as in ``_observe``."""
        if not self._recorded:
            return {}
        arrays = (*self.simulation.substates, sensors, self.parameters.gravity)
        return self._quantities.substeps(self._recorded, *_rows_of(arrays, index))

    def _place(self, rows: Tensor, start: dict[str, Tensor]) -> Tensor:
        """Puts worlds into their start state; returns the sensor values of all worlds."""
        count = int(rows.sum())
        qpos = self._stand.expand(count, -1).clone()
        qvel = torch.zeros(count, self.simulation.qvel.shape[1], dtype=torch.float64)
        places: dict[str, tuple[Tensor, Any]] = {
            "joint_position": (qpos, self._quantities.qpos_index),
            "joint_velocity": (qvel, self._quantities.qvel_index),
            "base_position": (qpos, slice(0, 3)),
            "base_orientation": (qpos, slice(3, 7)),
            "base_linear_velocity": (qvel, slice(0, 3)),
            "base_angular_velocity": (qvel, slice(3, 6)),
        }
        for key in start.keys() & places.keys():
            state, columns = places[key]
            state[:, columns] = start[key][rows].double()
        control = self._stand_control.expand(count, -1)
        floor = torch.full((count,), bool(start))  # rows that are put on it
        if "base_position" in start:
            floor = qpos[:, 0].isnan()
            qpos[floor, :3] = self._stand[:3]
        if floor.any():
            lift = -self._clearance(qpos)
            if "clearance" in start:
                lift += start["clearance"][rows, 0]
            qpos[:, 2] += torch.where(floor, lift, 0.0)
        return self.simulation.reset(rows, qpos, qvel, control)

    def _clearance(self, qpos: Tensor) -> Tensor:
        """Height of the lowest corner of the soles above the floor ``(K,)`` [m]."""
        position, rotation = self.simulation.site_poses(qpos, self._soles)
        # How far each corner is below its sole's center: few numbers, for which NumPy is faster.
        drop = np.abs(rotation.numpy()[..., 2, :2]) @ np.array(self.robot.sole_half_size)
        return torch.from_numpy((position.numpy()[..., 2] - drop).min(-1))

    @property
    def physics_param_spec(self) -> Composite:
        """Physical parameters that ``set_physics_params`` takes, see ``PhysicsParameters``."""
        return self.parameters.spec

    def set_physics_params(self, tensordict: TensorDictBase, mask: Tensor | None = None) -> None:
        """Gives worlds physical parameters of their own, from the coming step or reset on.

        Args:
            tensordict: any of the keys of ``physics_param_spec`` ``(N, ...)``; the others stay.
            mask: worlds whose parameters change ``(N,)`` bool; all if ``None``.

        Raises:
            ValueError: on a key that ``physics_param_spec`` does not have, another shape, a value
                out of its range, or a mask of another length.
        """
        rows = torch.ones(self.num_envs, dtype=torch.bool) if mask is None else mask.reshape(-1)
        if len(rows) != self.num_envs:
            raise ValueError(f"mask must be of {self.num_envs} worlds, got {len(rows)}.")
        fields = self.parameters.update(dict(tensordict.items()), rows)
        self.simulation.set_fields(rows, fields)

    def _set_seed(self, seed: int | None) -> None:
        self.rng.manual_seed(0 if seed is None else int(seed))

    def state_dict(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """State of the physics and of the random generator, enough to go on bit for bit."""
        return {
            "simulation": self.simulation.state_dict(),
            "rng": self.rng.get_state(),
            "parameters": self.parameters.state_dict(),
        }

    def load_state_dict(self, state_dict: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        """Restores what ``state_dict`` gave."""
        self.set_physics_params(TensorDict(state_dict["parameters"]))
        self._observed = None
        self.simulation.load_state_dict(state_dict["simulation"])
        self.rng.set_state(state_dict["rng"])


def _rows_of(arrays: Iterable[Tensor | None], index: Tensor | None) -> list[Any]:
    """The rows in ``index`` ``(K,)`` of each, all if it is ``None``; ``None`` stays."""
    if index is None:
        return list(arrays)
    return [None if array is None else array.index_select(0, index) for array in arrays]
