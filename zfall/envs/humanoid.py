"""The base env: named physical quantities out, servo targets and forces in."""

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import EnvBase
from torchrl.envs.transforms.utils import _get_reset

from zfall.envs.ball_state import BallState
from zfall.envs.base_state import check_made_for, made_for
from zfall.envs.control import Repeats, check_shape, read_control
from zfall.envs.forces import StepForces
from zfall.envs.observer import Observed, Observer, copies, with_flags
from zfall.envs.placing import Placing, start_of
from zfall.envs.rendering import Camera
from zfall.envs.streams import Streams
from zfall.robots import DEFAULT, Ball, Contact, PushPoint, Robot
from zfall.robots.servos import Servo
from zfall.simulation.compiled import sound
from zfall.simulation.cpu import Simulation
from zfall.simulation.memory import check_memory
from zfall.simulation.model import (
    actuator_order,
    compile_model,
    find_push_target,
    joint_range,
    physics_steps,
    push_targets,
    sensor_slices,
    servo_time_constant,
)
from zfall.simulation.parameters import PhysicsParameters
from zfall.simulation.quantities import (
    PEAK_KEYS,
    STATE_KEYS,
    action_spec,
    done_spec,
    observation_spec,
    with_substeps,
)
from zfall.simulation.read_quantities import QuantityReader
from zfall.simulation.servo_dynamics import ServoDynamics
from zfall.values import Count, Positive

__all__ = ["STATE_KEYS", "HumanoidEnv"]


class HumanoidEnv(EnvBase):
    """A batch of humanoids on a flat floor, with no task.

    Reads ``control``, servo targets ``(N, S, J)`` [rad] for each of the S physics steps of a
    control step; if that key is absent, ``target`` ``(N, J)``, which then acts in all of them.
    Reads ``("push", "wrench")`` ``(N, S, bodies, 6)`` [N, N m; world axes] if present;
    ``push_targets`` gives the index of each link and push point. Two keys change the state before
    the step, if present: ``("push", "kick")`` ``(N, 3)`` [m/s; world] is added to the base's
    velocity, and ``("ball", "launch")`` ``(N, 1)`` says where the ball is put to
    ``("ball", "start")`` ``(N, 6)`` [m, m/s; world]. ``fault`` ``(N, 1)`` bool, if present, ends a
    world as failed physics does, and so does a servo target that is not finite.

    Writes the quantities of the table in ``zfall.simulation.quantities``, which says how old each
    is in its step; after a reset all are those of the new state.

    ``reset`` puts worlds into the standing pose, or into what the keys ``("start", NAME)`` of its
    TensorDict say, see ``Placing``. TorchRL passes none to the env of a task, which is started by
    its transforms. ``record_substeps(keys)`` adds ``("substeps", key)`` ``(N, S, ...)``.

    Args:
        num_envs: number of worlds N.
        control_dt, physics_dt: time between two actions, and the physics' step, its divisor [s].
        robot: the robot.
        push_points: points for pushes in addition to the robot's, by name.
        ball: a ball that ``ThrownBall`` can throw.
        servos: by joint; those of the robot's MJCF if ``None``. See ``zfall.robots.servos``.
        servo_dynamics: whether ``servos`` feel load, supply and overload: ``ServoDynamics``.
        contact: how hard parts meet; as the robot's MJCF has it if ``None``.
        powered: whether the servos act at all; without power the robot is limp.
        threads: threads for the physics; all cores if ``None``.

    Raises:
        ValueError: on a bad number of worlds or time step, or an MJCF that lacks something.
    """

    _has_frame_skip = True  # substeps are ours: keeps TorchRL from wrapping the env
    batch_locked = True

    def __init__(
        self,
        *,
        num_envs: Count,
        control_dt: Positive,
        physics_dt: Positive = 0.004,
        robot: Robot = DEFAULT,
        push_points: dict[str, PushPoint] | None = None,
        ball: Ball | None = None,
        servos: Mapping[str, Servo] | None = None,
        servo_dynamics: bool = False,
        contact: Contact | None = None,
        powered: bool = True,
        threads: Count | None = None,
    ):
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, got {num_envs}.")
        substeps = physics_steps(control_dt, physics_dt)
        super().__init__(device=None, batch_size=[num_envs])  # with one, each step checks all keys
        self.robot, self.num_envs, self.substeps = robot, num_envs, substeps
        self.control_dt, self.physics_dt, self.contact = control_dt, physics_dt, contact
        self.regions, self.ball, self.servos = robot.regions, ball, servos
        if servos and servo_dynamics:  # which takes off what is lost in front of the shaft
            servos = {joint: each.before_gears() for joint, each in servos.items()}
        more: Any = {"push_points": push_points, "ball": ball, "servos": servos, "contact": contact}
        model = compile_model(robot, physics_dt=physics_dt, powered=powered, **more)
        check_memory(model, num_envs, substeps)
        self.simulation = Simulation(model, num_envs, substeps, threads)
        self.push_targets, self.num_bodies = push_targets(model), model.nbody - 1
        self.mass = float(model.body_mass.sum()) - (ball.mass if ball else 0.0)
        self.parameters = PhysicsParameters(model, robot, num_envs, servos, servo_dynamics)
        given = (model, robot.joints, servos, self.parameters.values, control_dt)
        self.servo_dynamics = ServoDynamics(*given) if servo_dynamics else None
        self.streams = Streams(num_envs)
        self.joint_range = joint_range(model, robot)
        self.stand_position = torch.tensor(robot.stand_position)
        self.servo_time_constant = servo_time_constant(model, robot)
        self._observed: Observed | None = None  # what the last step or reset gave
        self._repeats, self._forces = Repeats(), StepForces(num_envs)
        self._read = QuantityReader(
            robot, model, sensor_slices(model), mass=self.mass, control_dt=control_dt
        )
        self._to_actuators = actuator_order(model, robot)
        stand_control = self.stand_position.double()[self._to_actuators]
        self._placing = Placing(robot, model, self._read.places, stand_control)
        self._ball = BallState(model) if ball else None
        look = partial(compile_model, robot, physics_dt=physics_dt, look=True, **more)
        self.camera = Camera(look)
        self._made_for = made_for(self)
        self._observer = Observer(self._read, self.parameters, self._ball, self.servo_dynamics)
        self.observation_spec = observation_spec(robot, num_envs, self._observer.quantities)
        self.full_action_spec = action_spec(self.joint_range, num_envs, substeps)
        self.full_reward_spec = Composite(shape=(num_envs,))  # a task's transforms give the reward
        self.full_done_spec = done_spec(num_envs)
        self.set_seed(0)

    def push_target(self, point: str) -> int:
        """Index of a link or push point among the bodies of a wrench.

        Raises:
            ValueError: if there is none of this name.
        """
        return find_push_target(self.push_targets, point)

    def add_force(
        self,
        tensordict: TensorDictBase,
        target: int | Tensor,
        force: Tensor,
        rows: Tensor | None = None,
    ) -> TensorDictBase:
        """Lets a force act in the coming step, in addition to ``("push", "wrench")``.

        Args:
            tensordict: of the step. It then holds the sum, in a buffer lent for this step.
            target: what it acts on, as from ``push_target``; of each world ``(K,)`` or of all.
            force: in each physics step ``(K, S, 3)`` [N; world].
            rows: the worlds that it acts in ``(K,)``, each once; all N if ``None``.
        """
        wrench, there = self.simulation.wrench, tensordict.get(("push", "wrench"), None)
        self._forces.take(wrench, there)
        if there is not wrench:
            tensordict["push", "wrench"] = wrench
        self._forces.add(wrench, target, force, rows)
        return tensordict

    def record_substeps(self, keys: Iterable[str]) -> None:
        """Makes the env also write what ``keys`` are after each of the S physics steps.

        ``("substeps", key)`` ``(N, S, ...)``: entry s is the value after physics step s, so that
        the last one is ``key`` itself (but for ``base_acceleration`` and ``joint_torque``, which
        are means over the step); after a reset all are those of the new state. To be called before
        transforms wrap the env.

        Raises:
            ValueError: on a key that is not known at every physics step.
        """
        keys = self._observer.record(keys)
        self._observed = None
        self.observation_spec = with_substeps(self.observation_spec, keys, self.substeps)

    @torch.no_grad()
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self._repeats.check(tensordict, (self._observed or {}).get("base_position"))
        joints = len(self.robot.joints)
        control, fault = read_control(tensordict, (self.num_envs, self.substeps, joints))
        self._forces.take(self.simulation.wrench, tensordict.get(("push", "wrench"), None))
        kick = tensordict.get(("push", "kick"), None)
        if kick is not None:
            check_shape("push.kick", kick, (self.num_envs, 3))
            self.simulation.qvel[:, :3] += kick
        if self._ball:
            self._ball.launch(self.simulation, tensordict)
        if self.servo_dynamics:
            self.servo_dynamics.act(self.simulation)
        sensors = self.simulation.step(control[..., self._to_actuators])
        if self.servo_dynamics:
            self.servo_dynamics.advance(self.simulation, sensors)
        observed = self._observer(self.simulation, sensors)
        diverged = self.simulation.diverged | fault
        for key in PEAK_KEYS:  # of what is in between
            diverged = diverged | torch.from_numpy(~sound(observed[key].numpy()))
        if diverged.any():  # such a world ends here, in a state the learner can read
            sensors = self._place(diverged, {})
            observed = self._observer(self.simulation, sensors)
        self._observed = observed
        return with_flags(observed, diverged[:, None])

    @torch.no_grad()
    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        source = TensorDict(batch_size=self.batch_size) if tensordict is None else tensordict
        before, rows = self._observed, _get_reset("_reset", source).reshape(self.num_envs)
        sensors = self._place(rows, start_of(source))
        if before is None or rows.all():
            self._observed = self._observer(self.simulation, sensors)
        else:  # a few new rows among what the others had
            index = rows.nonzero()[:, 0]
            self._observed = self._observer(self.simulation, sensors, index, before)
        self._repeats.forget()
        return with_flags(self._observed, torch.zeros(self.num_envs, 1, dtype=torch.bool))

    def _place(self, rows: Tensor, start: Mapping[str, Tensor]) -> Tensor:
        if self.servo_dynamics:
            self.servo_dynamics.reset(self.simulation, rows)
        return self._placing.place(self.simulation, rows, start)

    @property
    def physics_param_spec(self) -> Composite:
        """Physical parameters that ``set_physics_params`` takes, see ``PhysicsParameters``."""
        return self.parameters.spec

    def set_physics_params(self, tensordict: TensorDictBase, mask: Tensor | None = None) -> None:
        """Gives worlds their own physical parameters, from the coming step or reset on.

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
        self.simulation.set_fields(rows, self.parameters.update(dict(tensordict.items()), rows))

    def _set_seed(self, seed: int | None) -> None:
        self.streams.begin(0 if seed is None else int(seed))

    def state_dict(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """All that the coming steps and resets depend on, enough to go on bit for bit."""
        servos = {"servos": self.servo_dynamics.state_dict()} if self.servo_dynamics else {}
        return servos | {
            "made_for": self._made_for,
            "simulation": self.simulation.state_dict(),
            "streams": self.streams.state_dict(),
            "parameters": self.parameters.state_dict(),
            "observed": copies(self._observed),
        }

    def load_state_dict(self, state_dict: Mapping[str, Any], *args: Any, **kwargs: Any) -> None:
        """Restores what ``state_dict`` gave.

        Raises:
            ValueError: if it is that of another env.
        """
        self.check_state(state_dict)
        self.set_physics_params(TensorDict(state_dict["parameters"]))
        self.simulation.load_state_dict(state_dict["simulation"])
        if "streams" in state_dict:  # else it is from before, see ``zfall.training``
            self.streams.load_state_dict(state_dict["streams"])
        if self.servo_dynamics:
            self.servo_dynamics.load_state_dict(state_dict["servos"])
        self._observed = copies(state_dict.get("observed"))
        self._repeats.forget()

    def check_state(self, state: Mapping[str, Any]) -> None:
        """Raises ``ValueError`` unless ``load_state_dict`` can restore a state."""
        check_made_for(state, self._made_for, self.simulation, self.streams)

    def render(self, height: int = 480, width: int = 640) -> NDArray[np.uint8]:
        """Pictures of all worlds by the camera ``track`` ``(N, height, width, 3)``.

        Raises:
            RuntimeError: if no OpenGL is to be had.
        """
        return self.camera.pictures(self.simulation.qpos.numpy(), height, width)
