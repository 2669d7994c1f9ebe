"""The pose around which a policy acts while it kneels."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.rotations import turn_to_heading
from zfall.envs.transforms.observations.measured import read_measured
from zfall.envs.transforms.starts import reset_rows

SECTORS = 8  # headings of a fall, the first straight ahead, the others to the left of it


class KneelReference(Transform):
    """Moves the reference of the targets to a safe posture once the robot is to kneel.

    ``target = clamp(target + way - stand, joint range)``: ``way`` is the standing pose in mode
    RECOVER, from where in the other modes every joint goes to a posture at ``speed``. A policy
    that does nothing so kneels by script; one that learns corrects the script, by as much as the
    target before it, which the joint ranges bound too, leaves. The postures are not symmetric:
    what mirrors actions (``symmetry``) does not fit.

    The posture is the robot's kneel until the center of mass moves faster than ``moving`` along
    the ground; then once and for all that of ``Robot.catches`` for the nearest heading.

    Keys: reads ``mode``, ``base_orientation`` and ``com_velocity`` [m/s], as measured where
    sensing wrote it; changes ``target`` ``(N, J)`` [rad]. Comes after ``JointPositionTarget``.

    Args:
        env: the base env.
        speed: of each joint [rad/s].
        moving: speed of the center of mass at which the posture is chosen [m/s].

    Raises:
        ValueError: if the robot has no kneel or catches no falls, or a number is not positive.
    """

    way: Tensor
    choice: Tensor

    def __init__(self, env: HumanoidEnv, *, speed: float = 6.0, moving: float = 0.3):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["target"])
        robot = env.robot
        if not robot.kneel or sorted(robot.catches) != list(range(0, 181, 360 // SECTORS)):
            raise ValueError(
                "KneelReference needs a robot with a kneel and catches for headings of 0, 45, 90, "
                f"135 and 180 degrees; {robot.name} has {sorted(robot.catches)}."
            )
        for name, value in (("speed", speed), ("moving", moving)):
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}.")
        self.speed, self.moving = speed, moving
        self.control_dt, self.stand, self.range = (
            env.control_dt,
            env.stand_position,
            env.joint_range,
        )
        self.postures = torch.tensor([*robot.catch_positions, robot.kneel_position])
        self.register_buffer("way", env.stand_position.repeat(env.num_envs, 1))
        self.register_buffer("choice", torch.full((env.num_envs,), SECTORS))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        mode = tensordict.get("mode", None)
        if mode is None:
            raise ValueError("KneelReference needs the key mode: put a ModeMachine into the table.")
        if "control" in tensordict.keys():
            raise ValueError(
                "KneelReference must come right after a JointPositionTarget, before what writes "
                "control."
            )
        recover = mode[:, 0] > 0
        velocity = read_measured(tensordict, "com_velocity")[:, :2]
        x, y = turn_to_heading(tensordict["base_orientation"], velocity).unbind(-1)
        sector = (torch.atan2(y, x) * (SECTORS / (2.0 * torch.pi))).round().long() % SECTORS
        chosen = (self.choice == SECTORS) & (torch.hypot(x, y) > self.moving)
        choice = torch.where(chosen, sector, self.choice)
        self.choice = torch.where(recover, SECTORS, choice)
        reach = self.speed * self.control_dt
        further = self.way + (self.postures[self.choice] - self.way).clamp(-reach, reach)
        self.way = torch.where(recover[:, None], self.stand, further)
        target = tensordict["target"] + self.way - self.stand
        return tensordict.set("target", torch.clamp(target, *self.range.unbind(-1)))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict)
        self.way = torch.where(rows[:, None], self.stand, self.way)
        self.choice = torch.where(rows, SECTORS, self.choice)
        return tensordict_reset
