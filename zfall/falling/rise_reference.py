"""The way up along which the servos go while the robot rises."""

from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.actions.commands import targets_before
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.observations.measured import read_measured
from zfall.envs.transforms.values import reset_rows
from zfall.falling.lying import POSTURES, posture_of
from zfall.falling.modes import RISE, STABLE
from zfall.falling.rises import GOALS, load_rises, rises_path
from zfall.fingerprints import reads_files
from zfall.values import NotNegative

MEMORY = 0.12  # time over which the accelerometer is averaged [s]
_BELLY, _KNEEL = POSTURES.index("belly"), POSTURES.index("kneel")


@reads_files(lambda values, robot: [Path(values.get("rises") or rises_path(robot))], "rises")
class RiseReference(Transform):
    """Gets the robot up in mode RISE, by the movement for how it lies or kneels.

    The posture is where gravity points in axes of the base: back, belly, left, right or, upright,
    kneel. It is read from the accelerometer, averaged over ``MEMORY`` seconds: an estimated roll
    means nothing to a robot on its belly, whose pitch is 90 degrees. The target goes through the
    keyframes of the movement, whatever the policy does. Of several movements for a posture it is
    the one that begins nearest to the angles of the joints.

    Where a movement was to end on the belly and does, the next one begins at once; where it ends
    lying otherwise, ``pause`` seconds later: so the robot rolls from its back to its belly, gets
    up from there, and tries again if it fell. Where it ends
    upright the robot keeps the last keyframe; if it is still in mode RISE after ``patience``
    seconds, it begins anew as from a kneel. A robot that is on its way from belly or kneel to
    standing, and finds itself on its back or side, begins with the movement for that at once.

    Keys: reads ``mode`` ``(N, 4)``, ``base_acceleration`` ``(N, 3)`` [m/s2] and
    ``joint_position`` ``(N, J)`` [rad], measured where sensing wrote them; changes ``target``
    ``(N, J)`` [rad]. Comes after the other references, before ``StableHold``.

    Args:
        env: the base env.
        pause: time after a movement before the next, for a robot that may still roll [s].
        patience: time of being upright in mode RISE after which it begins anew [s].
        rises: file of the movements; ``None``: that of the robot.

    Raises:
        ValueError: if there are no movements, or a time is negative; in the first step, if nothing
            writes a ``mode`` with RISE or ``control`` is there already.
    """

    acts_by_itself = True  # a baseline that holds still leaves it out

    way: Tensor
    begin: Tensor
    acceleration: Tensor
    number: Tensor
    clock: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        pause: NotNegative = 0.4,
        patience: NotNegative = 1.0,
        rises: str | None = None,
    ):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["target"])
        needs_env(self, env, "a memory of each world's commands")
        for name, value in (("pause", pause), ("patience", patience)):
            if not value >= 0:
                raise ValueError(f"{name} must not be negative, got {value}.")
        self.pause, self.patience, self.control_dt = pause, patience, env.control_dt
        self.range = env.joint_range
        self.rises = load_rises(env.robot, None if rises is None else Path(rises))
        for name in ("way", "begin"):  # the last target, and that where the movement began
            self.register_buffer(name, env.stand_position.repeat(env.num_envs, 1))
        # Of each world, the movement and for how many steps it goes on; -1 before the first.
        self.register_buffer("acceleration", torch.zeros(env.num_envs, 3))  # its average [m/s2]
        self.share = min(1.0, env.control_dt / MEMORY)
        self.register_buffer("number", torch.zeros(env.num_envs, dtype=torch.long))
        self.register_buffer("clock", torch.full((env.num_envs,), -1))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        base_env_of(self)
        mode = tensordict.get("mode", None)
        if mode is None or mode.shape[-1] <= RISE:
            raise ValueError("RiseReference needs a ModeMachine with rise in the table.")
        if "control" in tensordict.keys():
            raise ValueError("RiseReference must come before what writes control.")
        new = read_measured(tensordict, "base_acceleration") - self.acceleration
        self.acceleration = self.acceleration + self.share * new
        rising, stable = mode[:, RISE] > 0, mode[:, STABLE, None] > 0
        target = torch.where(stable, self.way, tensordict["target"])  # as StableHold will have it
        if not rising.any():  # nearly always
            self.clock.fill_(-1)
            self.way = target
            return tensordict
        joints = read_measured(tensordict, "joint_position")
        new = rising & self._begins(posture_of(-self.acceleration), joints)
        self.begin = torch.where(new[:, None], self.way, self.begin)
        self.clock = torch.where(new, 0, self.clock)
        time = (self.clock + 1) * self.control_dt
        goes = self.rises.target(self.number, self.begin, time)
        self.way = torch.where(rising[:, None], goes, target)
        self.clock = torch.where(rising, self.clock + 1, -1)
        clamped = torch.clamp(goes, *self.range.unbind(-1))
        return tensordict.set("target", torch.where(rising[:, None], clamped, tensordict["target"]))

    def _begins(self, posture: Tensor, joint_position: Tensor) -> Tensor:
        """Worlds in which a movement begins, for this posture and these angles ``(N,)`` bool."""
        time = self.clock * self.control_dt
        upright = posture == _KNEEL
        arrived = (posture == _BELLY) & (self.rises.goal[self.number] == GOALS.index("belly"))
        wait = torch.where(upright, self.patience, torch.where(arrived, 0.0, self.pause))
        over = self.rises.over(self.number, time - wait)
        getting_up = self.rises.goal[self.number] == GOALS.index("stand")
        stumbled = getting_up & ~upright & (posture != _BELLY)
        new = (self.clock < 0) | over | stumbled
        self.number = torch.where(new, self.rises.choose(posture, joint_position), self.number)
        return new

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        before = targets_before(tensordict, tensordict_reset["joint_position"])
        self.way = torch.where(rows[:, None], before, self.way)
        self.clock = torch.where(rows, -1, self.clock)
        now = read_measured(tensordict_reset, "base_acceleration")
        self.acceleration = torch.where(rows[:, None], now, self.acceleration)
        return tensordict_reset
