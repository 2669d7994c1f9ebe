"""The way down around which a policy acts while it kneels."""

import math
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.mirror import mirror_quantity
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.observations.measured import read_measured
from zfall.envs.transforms.values import per_world, reset_rows
from zfall.falling.movements import catches_path, load_catches
from zfall.fingerprints import reads_files
from zfall.rotations import turn_to_heading
from zfall.values import NotNegative, NotNegativeOrInfinite, Positive

SETTLE = 0.06  # time in which another movement may take the place of the first [s]


@reads_files(lambda values, robot: [Path(values.get("catches") or catches_path(robot))], "catches")
class KneelReference(Transform):
    """Moves the reference of the targets along a safe way down once the robot is to kneel.

    ``target = clamp(way + share (target - stand), joint range)``. In mode RECOVER ``way`` is the
    standing pose and ``share`` 1; in the others every joint goes at ``speed`` through the postures
    of a movement. A policy whose actions are zero so kneels by script; a policy that learns
    corrects the script, within the joint ranges.

    The posture is the robot's ``kneel`` until the center of mass moves faster than ``moving``
    along the ground. Then the movement begins that ``recipes.falling.catches`` found for falls of
    the nearest heading and speed. For ``settle`` the choice is made anew in every step, since a
    push may still act. Falls to the left and to the right have different movements: the losses and
    augmentations of ``symmetry`` fit only roughly. In worlds with ``fall_mirrored`` movement and
    correction are the image of those of the other side.

    Keys: reads ``mode`` ``(N, 3)``, ``base_orientation`` ``(N, 4)`` and ``com_velocity``
    ``(N, 3)`` [m/s], measured where sensing wrote them, and ``fall_mirrored`` ``(N, 1)`` if
    ``MirroredFalls`` writes it; changes ``target`` ``(N, J)`` [rad]. Comes after
    ``JointPositionTarget``.

    Args:
        env: the base env.
        speed: of each joint [rad/s].
        moving: speed of the center of mass at which the movement begins [m/s].
        settle: time in which another movement may take its place [s].
        landing: time from the movement's begin for which the policy corrects it [s]. Over the same
            time again its share fades to 0, so that the robot comes to rest by script. ``None``:
            the policy always corrects, as it does before there is a movement.
        catches: file of the movements; ``None``: that of the robot.

    Raises:
        ValueError: if the robot has no posture ``kneel``, there are no catches, or a number is not
            positive; in the first step, if nothing writes ``mode`` or ``control`` is there already.
    """

    acts_by_itself = True  # a baseline that holds still leaves it out

    way: Tensor
    choice: Tensor
    clock: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        speed: Positive = 6.0,
        moving: NotNegativeOrInfinite = 0.3,
        settle: NotNegative = SETTLE,
        landing: Positive | None = None,
        catches: str | None = None,
    ):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["target"])
        needs_env(self, env, "a memory of each world's commands")
        robot = env.robot
        kneel = torch.tensor(robot.posture("kneel"))
        landing = math.inf if landing is None else landing
        positive = {"speed": speed, "moving": moving, "settle": settle, "landing": landing}
        for name, value in positive.items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}.")
        self.speed, self.moving, self.settle, self.landing = speed, moving, settle, landing
        self.control_dt, self.stand, self.range = (
            env.control_dt,
            env.stand_position,
            env.joint_range,
        )
        self.catches = load_catches(robot, None if catches is None else Path(catches))
        index, sign = mirror_quantity(robot, "target")
        self.mirror_index, self.mirror_sign = torch.tensor(index), torch.tensor(sign)
        movements = self.catches.postures.flatten(0, 1)
        movements = torch.cat([movements, kneel.expand(1, movements.shape[1], -1)])
        self.movements = torch.stack([movements, self._image(movements)])  # by the side
        self.none = len(movements) - 1  # the kneel, of worlds that do not move yet
        self.register_buffer("way", env.stand_position.repeat(env.num_envs, 1))
        self.register_buffer("choice", torch.full((env.num_envs,), self.none))
        self.register_buffer("clock", torch.zeros(env.num_envs, dtype=torch.long))  # [steps]

    def _image(self, angles: Tensor) -> Tensor:
        return angles[..., self.mirror_index] * self.mirror_sign

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        base_env_of(self)
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
        x, y = turn_to_heading(read_measured(tensordict, "base_orientation"), velocity).unbind(-1)
        correction = tensordict["target"] - self.stand
        side: Tensor | int = 0
        mirrored = tensordict.get("fall_mirrored", None)
        if mirrored is not None:
            side = mirrored[:, 0].long()
            y = torch.where(mirrored[:, 0], -y, y)
            correction = torch.where(mirrored, self._image(correction), correction)
        open_still = (self.choice == self.none) | (
            self.clock * self.control_dt < self.settle - 1e-6
        )
        chosen = open_still & (torch.hypot(x, y) > self.moving)
        choice = torch.where(chosen, self.catches.nearest(x, y), self.choice)
        self.choice = torch.where(recover, self.none, choice)
        waits = self.choice == self.none
        clock = torch.where(waits, 0, self.clock)
        phase = torch.bucketize(clock * self.control_dt + 1e-6, self.catches.until, right=True)
        reach = torch.as_tensor(per_world(self.speed, 2)) * self.control_dt
        further = self.movements[side, self.choice, phase] - self.way
        self.way = torch.where(
            recover[:, None], self.stand, self.way + further.clamp(-reach, reach)
        )
        self.clock = torch.where(waits, 0, clock + 1)
        share = (2.0 - clock * self.control_dt / self.landing).clamp(0.0, 1.0)[:, None]
        target = self.way + share * correction
        return tensordict.set("target", torch.clamp(target, *self.range.unbind(-1)))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        self.way = torch.where(rows[:, None], self.stand, self.way)
        self.choice = torch.where(rows, self.none, self.choice)
        self.clock = torch.where(rows, 0, self.clock)
        return tensordict_reset
