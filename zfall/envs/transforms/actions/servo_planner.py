"""The motion planner in a servo's firmware."""

import math
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.actions.commands import read_commands, targets_before
from zfall.envs.transforms.base_env import needs_env, streams_of
from zfall.envs.transforms.drawn import declare_drawn, drawn_mirror, show_drawn
from zfall.envs.transforms.values import per_world, reset_rows, two_numbers
from zfall.values import Name, NotNegative, NotNegativeBounds, Positive


class ServoPlanner(Transform):
    """Moves the servos' set-points toward the commands with bounded speed and acceleration.

    The set-point follows a trapezoidal profile: in each physics step dt it takes the speed nearest
    to the command from which it can still stop there, braking by whole steps. With
    ``h = acceleration dt``, the way left after this step's share of the old speed,
    ``rest = command - position - speed dt / 2``, and ``u = 2 |rest| / (h dt)``::

        n = floor(sqrt(u + 1/4) - 1/2)
        speed = sign(rest) h (n + u / (n + 1)) / 2

    bounded by ``velocity``, and by h around the speed before; the position moves by dt times
    the mean of the old and the new speed. A command that keeps still is reached within two
    physics steps after the time of the continuous profile, never passed; one that comes closer
    than the braking distance is passed and come back to.

    Keys: reads ``control`` ``(N, S, J)`` [rad] if an earlier transform wrote it, else ``target``
    ``(N, J)``; writes ``control``, the set-points at the end of each physics step. They begin an
    episode at rest where the joints are or ``targets_before`` says. With ``param`` also writes
    ``("params", param)`` ``(N, 1)``, the largest acceleration [rad/s2].

    Args:
        env: the base env.
        velocity: largest speed [rad/s]; ``null`` sets none.
        acceleration: largest acceleration [rad/s2]; 0 sets none, like the register of a servo, so
            that the set-point goes to the command as fast as ``velocity`` lets it; ``null`` takes
            that of each servo of the env, from its register. Of two, the smallest and the largest,
            it is drawn per episode, one for all joints of a world.
        param: name under which a drawn acceleration is shown; ``null``: it is not.

    Raises:
        ValueError: if a limit is not positive, there are no servos to take it from, or what is
            to be shown is not drawn.

    Source: the limits are those that the robot's maker publishes for its servos (ksim-zbot,
    ``max_velocity`` and ``max_acceleration``); the profile is ours, exact in discrete time.
    """

    hardware = "commands"
    position: Tensor
    speed: Tensor
    drawn: Tensor | None

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        velocity: Positive | None = 5.0,
        acceleration: NotNegative | NotNegativeBounds | None = 39.0,
        param: Name | None = None,
    ):
        super().__init__(in_keys_inv=["control"], out_keys_inv=["control"])
        needs_env(self, env, "a memory of each world's commands")
        if velocity is not None and not velocity > 0:
            raise ValueError(f"velocity must be positive, got {velocity}.")
        is_drawn, self.bounds = isinstance(acceleration, Sequence), (0.0, 0.0)
        if acceleration is not None:
            bounds = acceleration if isinstance(acceleration, Sequence) else [acceleration] * 2
            self.bounds = low, high = two_numbers("acceleration", bounds)
            if not 0 <= low <= high:
                raise ValueError(
                    f"acceleration must be positive, or 0 for none, got {acceleration}."
                )
        if param is not None and not is_drawn:
            raise ValueError(f"param must be null where nothing is drawn, got {param}.")
        self.param, self.mirror_signs = param, drawn_mirror(param)
        self.register_buffer("drawn", torch.zeros(env.num_envs, 1) if is_drawn else None)
        self.velocity = math.inf if velocity is None else velocity
        self.acceleration = _of_servos(env) if acceleration is None else self.bounds[1]
        self.physics_dt, self.substeps = env.physics_dt, env.substeps
        self.register_buffer("position", env.stand_position.repeat(env.num_envs, 1))
        self.register_buffer("speed", torch.zeros(env.num_envs, len(env.stand_position)))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        half = self.physics_dt / 2
        acceleration = self.acceleration if self.drawn is None else self.drawn
        change = per_world(acceleration, 2) * self.physics_dt
        fastest = per_world(self.velocity, 2)
        at_once = torch.as_tensor(change == 0.0)
        way = torch.as_tensor(fastest * self.physics_dt)
        control = read_commands(self, tensordict, self.substeps).clone()
        position, speed = self.position, self.speed
        for step in range(self.substeps):
            rest = control[:, step] - position - half * speed
            u = rest.abs() / (half * change)
            n = (u + 0.25).sqrt_().sub_(0.5).floor_()
            most = ((u / (n + 1.0)).add_(n) * (change / 2)).clamp_max(fastest)
            wanted = torch.copysign(most, rest)
            before, speed = speed, torch.clamp(wanted, speed - change, speed + change)
            ramped = position + half * (before + speed)
            if at_once.any():
                free = position + (control[:, step] - position).clamp(-way, way)
                ramped, speed = torch.where(at_once, free, ramped), speed.where(~at_once, 0.0)
            position = ramped
            control[:, step] = position
        self.position, self.speed = position, speed
        return tensordict.set("control", control)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)[:, None]
        before = targets_before(tensordict, tensordict_reset["joint_position"])
        self.position = torch.where(rows, before, self.position)
        self.speed = torch.where(rows, 0.0, self.speed)
        if self.drawn is not None:
            low, high = self.bounds
            u = streams_of(self).uniform((1,), rows[:, 0])
            self.drawn = torch.where(rows, low + (high - low) * u, self.drawn)
        return self._show(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._show(next_tensordict)

    def _show(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict if self.drawn is None else show_drawn(tensordict, self.param, self.drawn)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        return declare_drawn(observation_spec, self.param)


def _of_servos(env: HumanoidEnv) -> Tensor:
    """Acceleration by the register of each joint's servo ``(1, J)`` [rad/s2], 0 without a ramp."""
    if env.servos is None:
        raise ValueError(
            "acceleration must be a number, got null, with servos that have no register; "
            "servo=datasheet has servos that do."
        )
    each = [env.servos[joint] for joint in env.robot.joints]
    return torch.tensor([[servo.acceleration * servo.acceleration_step for servo in each]])
