"""From velocities to consistent servo targets."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.on_robot import Known, OnRobot, at_begin, seen
from zfall.envs.transforms.actions.action import read_action, replace_control
from zfall.envs.transforms.actions.commands import check_chain, refuse_commands, targets_before
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.values import per_world, reset_rows
from zfall.values import Positive


class JointVelocityTarget(Transform):
    """Reads the action as joint velocities and integrates them into consistent servo targets.

    ``v = limit * clamp(action, -1, 1)`` holds for a control step, in which the target moves by
    ``q(t) = clamp(q(0) + v t, joint range)`` from where it ended before. At the beginning t of
    each tick of the low level (the first one lies at the beginning of the control step) position
    and velocity are sampled together and stay until the next tick. The servo has no input for a
    velocity; what its damping would take away is put on the command instead::

        command = q(t) + (damping / stiffness) * v(t)

    so that its torque is ``stiffness (q(t) - q) + damping (v(t) - dq/dt)``, with the nominal
    gains of the compiled model. ``v(t)`` is the slope of q from this tick to the next: v, less in
    the tick in which the target meets a stop, 0 at the stop. The integrator holds the clamped
    value, so that it leaves a stop as soon as the action turns around. Without ``feedforward``
    the command is q(t) alone, which goes on without a jump where the action turns around; the
    joint then follows it by damping / stiffness [s] later.

    Keys: reads ``action`` ``(N, J)``; writes ``target`` ``(N, J)`` [rad], where q is at the end
    of the step, also as an observation, and ``control`` ``(N, S, J)`` [rad]. After a reset the
    target is where the joints are or ``targets_before`` says, within their ranges.

    Args:
        env: the base env.
        limit: velocity of an action of 1 [rad/s].
        rate: of the low level [Hz]; that of the physics if ``None``.
        feedforward: whether the velocity is sent along with the position.

    Raises:
        ValueError: if ``limit`` is not positive, or a tick is not a whole number of physics
            steps, or a control step not one of ticks; at a reset or in a step, if a transform acts
            on commands before this one makes them.

    Source: velocities integrated into position targets, and these alone: Ferigo et al., "On the
    emergence of whole-body strategies from humanoid robot push-recovery learning", RA-L 2021,
    section IV-A; consistent position and velocity at a low level's rate: Duburcq et al.,
    "Reactive stepping for humanoid robots using reinforcement learning", IROS 2022, section IV.
    The velocity goes through the position command, as these servos take nothing else.
    """

    units: ClassVar[Mapping[str, str]] = {"target": "rad"}

    range: Tensor
    time_constant: Tensor
    time: Tensor
    position: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        limit: Positive,
        rate: Positive | None = None,
        feedforward: bool = True,
    ):
        super().__init__(in_keys_inv=["target", "control"], out_keys_inv=["action"])
        needs_env(self, env, "a memory of each world's commands")
        if not limit > 0:
            raise ValueError(f"limit must be positive, got {limit}.")
        steps = [n for n in range(1, env.substeps + 1) if env.substeps % n == 0]
        rates = {n: 1 / (n * env.physics_dt) for n in steps}
        fitting = [n for n in steps if rate is not None and abs(rate / rates[n] - 1) < 1e-6]
        if rate is not None and not fitting:
            raise ValueError(
                "rate must divide the control step into ticks of whole physics steps, one of "
                f"{', '.join(f'{value:g}' for value in rates.values())} with control_dt "
                f"{env.control_dt} and physics_dt {env.physics_dt}; got {rate}."
            )
        self.limit = limit
        self.hold = fitting[0] if fitting else 1  # physics steps of a tick
        self.tick = self.hold * env.physics_dt
        self.register_buffer("range", env.joint_range)
        lead = env.servo_time_constant
        self.register_buffer("time_constant", lead if feedforward else torch.zeros_like(lead))
        ticks = env.substeps // self.hold
        self.register_buffer("time", self.tick * torch.arange(ticks + 1)[:, None])
        self.register_buffer("position", env.stand_position.repeat(env.num_envs, 1))

    def action_toward(self, angles: Tensor, target: Tensor) -> Tensor:
        """The action ``(N, J)`` that moves targets ``(N, J)`` to ``angles`` ``(J,)`` [rad]."""
        speed = (angles - target) / (len(self.time) - 1) / self.tick
        return (speed / per_world(self.limit, 2)).clamp(-1.0, 1.0)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        base_env_of(self)
        refuse_commands(self, tensordict)
        low, high = self.range.unbind(-1)
        action = read_action(tensordict, len(self.range)).clamp(-1.0, 1.0)
        velocity = action * per_world(self.limit, 2)
        lead = self.time_constant / self.tick
        command, end = _integrated(self.position, velocity, self.time, low, high, lead)
        self.position = end.clone()
        tensordict["target"] = self.position.clone()
        if self.hold > 1:
            command = command.repeat_interleave(self.hold, 1)
        return tensordict.set("control", command)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self.position = tensordict["target"].clone()  # which others may have delayed
        return next_tensordict.set("target", tensordict["target"])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        check_chain(self)
        rows = reset_rows(tensordict, self)
        start = targets_before(tensordict, tensordict_reset["joint_position"])
        start = start.clamp(*self.range.unbind(-1))
        self.position = torch.where(rows[:, None], start, self.position)
        return tensordict_reset.set("target", self.position.clone())

    def on_robot(self) -> OnRobot:
        """The same on a robot, which begins with its joints' measured angles as targets."""
        return _VelocityOnRobot(self)

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        one = torch.ones(len(self.range))
        return replace_control(input_spec, -one, one)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        observation_spec["target"] = Unbounded(self.position.shape)
        return observation_spec


def _integrated(
    start: Tensor, velocity: Tensor, time: Tensor, low: Tensor, high: Tensor, lead: Tensor
) -> tuple[Tensor, Tensor]:
    """Commands of the ticks ``(N, K, J)`` and the position at the end ``(N, J)`` [rad]."""
    position = torch.clamp(start[:, None] + velocity[:, None] * time, low, high)
    begin, end = position[:, :-1], position[:, 1:]  # of each tick, so that their distance over
    # the tick is the slope: less than the velocity where the stop is met.
    return torch.lerp(begin, end, lead), position[:, -1]


class _VelocityOnRobot(OnRobot):
    def __init__(self, made: JointVelocityTarget):
        super().__init__(["joint_position"], ["target"], {"target": made.position[:1].clone()})
        self.limit = float(made.limit)
        low, high = made.range.unbind(-1)
        lead = made.time_constant / made.tick
        for name, value in {"low": low, "high": high, "lead": lead, "time": made.time}.items():
            self.register_buffer(name, value.clone())

    def observe(self, known: Known) -> None:
        low, high = self.get_buffer("low"), self.get_buffer("high")
        start = torch.clamp(seen(known, "joint_position"), low, high)
        known["target"] = at_begin(known, start, known["state", "target"])

    def act(self, known: Known) -> None:
        velocity = known["action"].clamp(-1.0, 1.0) * self.limit
        own = (self.get_buffer(name) for name in ("time", "low", "high", "lead"))
        known["command"], known["next", "target"] = _integrated(known["target"], velocity, *own)
