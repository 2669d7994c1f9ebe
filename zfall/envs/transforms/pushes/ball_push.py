"""A ball in the place of a push."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.robots import GRAVITY
from zfall.values import Positive


class BallPush(Transform):
    """Throws the env's ball with the momentum of a push, which does not act itself.

    In a control step in which pushes of impulse J would act, the ball is launched with the level
    velocity ``v = J / m`` of its mass m. It starts ``flight`` seconds away from a point ``aim``
    above the center of mass, as high as that point, and flies there in a parabola:
    ``p = target - v T``, ``v_z = g T / 2``. A push that lasts several control steps is a throw in
    each of them, so a push should last one at most. A ball that bounces off gives the robot more
    than J, one that grazes it less.

    Keys: reads and clears ``("push", "wrench")`` ``(N, S, bodies, 6)``, which the transforms
    before it in the table wrote; reads ``com_position`` ``(N, 3)`` [m]; writes
    ``("ball", "launch")`` and ``("ball", "start")`` as ``ThrownBall`` does.

    Args:
        env: the base env, built with a ``ball``.
        flight: time from the launch to the target [s].
        aim: of the target above the center of mass [m].

    Raises:
        ValueError: if the env has no ball, or the flight takes no time.

    Source: Ferigo et al., RA-L 2021, section VI-B, throws "high-speed objects" at the robot; sizes
    and the flight are ours.
    """

    def __init__(self, env: HumanoidEnv, *, flight: Positive = 0.2, aim: float = 0.0):
        keys = [("ball", "launch"), ("ball", "start")]
        super().__init__(in_keys_inv=keys, out_keys_inv=keys)
        needs_env(self, env, "physics to act on")
        if env.ball is None:
            raise ValueError(
                "BallPush must have a ball to throw: give base_env.ball, for instance "
                "{_target_: zfall.robots.Ball, mass: 0.5, radius: 0.04}; got none."
            )
        if not flight > 0:
            raise ValueError(f"flight must be positive, got {flight}.")
        self.flight, self.aim = flight, aim
        self.mass, self.physics_dt = env.ball.mass, env.physics_dt

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        base_env_of(self)
        wrench = tensordict.pop(("push", "wrench"), None)
        velocity = torch.zeros_like(tensordict["com_position"])
        if wrench is not None:
            impulse = wrench[..., :3].sum((1, 2)) * self.physics_dt
            velocity[:, :2] = impulse[:, :2] / self.mass
        launch = velocity.norm(dim=-1, keepdim=True) > 0
        tensordict["ball", "launch"] = launch
        tensordict["ball", "start"] = self.start(tensordict["com_position"], velocity)
        return tensordict

    def start(self, com: Tensor, velocity: Tensor) -> Tensor:
        """Position and velocity of the ball at its launch ``(N, 6)`` [m, m/s; world].

        Args:
            com: the center of mass ``(N, 3)`` [m].
            velocity: level, of the ball ``(N, 3)`` [m/s].
        """
        target = com + torch.tensor([0.0, 0.0, self.aim])
        rise = torch.tensor([0.0, 0.0, 0.5 * GRAVITY * self.flight])
        return torch.cat([target - velocity * self.flight, velocity + rise], -1)
