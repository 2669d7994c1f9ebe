"""What a recovery costs: torques, energy, and how roughly the joints are commanded."""

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.followers import Ended, Moment

SATURATED = 0.95  # share of the largest torque from which a servo counts as saturated


def at_their_limit(env: HumanoidEnv, torque: Tensor) -> Tensor:
    """Whether torques exceed 95 % of the largest that a servo could give in this step.

    That depends on voltage and randomisation, with ``servo_dynamics`` also on sag and overload.

    Args:
        env: the base env.
        torque: of all joints ``(N, J)`` [N m].
    """
    model = env.simulation.model
    servos = [model.actuator(joint).id for joint in env.robot.joints]
    largest = env.simulation.field("actuator_forcerange")[:, servos, 1]
    return torque.abs() > SATURATED * torch.from_numpy(largest).float()


class Effort:
    """Sums over joints and control steps, from the push until a trial ends.

    ``joint_torque_rms`` [N m], of means over control steps; ``energy`` [J], of the absolute power
    torque x velocity: what a servo takes in when it brakes is not given back;
    ``torque_saturation``, share of torques ``at_their_limit``; ``target_jerk`` [rad/s3], root mean
    square of the third difference of the joint targets.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: HumanoidEnv):
        n = env.num_envs
        self.env, self.dt = env, env.control_dt
        self.steps, self.jerks = torch.zeros(n), torch.zeros(n)
        self.torque, self.energy = torch.zeros(n), torch.zeros(n)
        self.saturated, self.jerk = torch.zeros(n), torch.zeros(n)
        self._targets: list[Tensor] = []

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Nothing counts before the push."""

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step."""
        torque, share = td["joint_torque"], now.upto_fall.float()
        self.steps += share
        self.torque += share * torque.square().mean(-1)
        power = (torque * td["joint_velocity"]).abs().sum(-1)
        self.energy += share * power * self.dt
        self.saturated += share * at_their_limit(self.env, torque).float().mean(-1)
        self._targets = [*self._targets[-3:], td["target"].clone()]
        if len(self._targets) == 4:
            a, b, c, d = self._targets
            jerk = (d - 3 * c + 3 * b - a) / self.dt**3
            self.jerk += share * jerk.square().mean(-1)
            self.jerks += share

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Columns ``(N,)``; NaN for a trial that was over before the push."""
        return {
            "joint_torque_rms": (self.torque / self.steps).sqrt(),
            "energy": torch.where(self.steps > 0, self.energy, torch.nan),
            "torque_saturation": self.saturated / self.steps,
            "target_jerk": (self.jerk / self.jerks).sqrt(),
        }
