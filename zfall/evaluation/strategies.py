"""How a push was met: steps, displacement, time, and the strategies of Duburcq et al., table I."""

from typing import ClassVar

import numpy as np
import pandas as pd
import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.followers import Ended, Moment
from zfall.robots import GRAVITY
from zfall.rotations import tilt

STRIDE = 0.02  # a foot that comes down so far from where it left has stepped [m]
CALM = 0.1  # speed of the center of mass below which the robot has come to rest [m/s]
FOOT_TILT = 0.15  # of a sole that stays on the floor [rad]
HIP = 0.25  # of a hip's pitch or roll, away from where it was at the push [rad]
MOMENTUM = 0.05  # angular momentum about the center of mass, in units of m h0 sqrt(g h0)


class Footsteps:
    """Sees feet come down at least 2 cm from where they had left the floor.

    Args:
        worlds: number N of them.
    """

    def __init__(self, worlds: int):
        self._contact = torch.ones(worlds, 2, dtype=torch.bool)  # in the last step
        self._left: Tensor | None = None  # where they stood last

    def update(self, td: TensorDictBase) -> Tensor:
        """Takes in a control step; returns which feet have just stepped ``(N, 2)`` bool."""
        contact, feet = td["feet_contact"], td["feet_position"][..., :2]
        stood = feet if self._left is None else self._left
        landed = contact & ~self._contact & ((feet - stood).norm(dim=-1) > STRIDE)
        self._contact = contact
        self._left = torch.where(contact[..., None], feet, stood)
        return landed


class Strategies:
    """Follows the feet, hips and momenta from the push until a trial ends.

    ``steps``: times that a foot came down at least 2 cm from where it had left the floor.
    ``displacement`` [m]: of the center of mass, level, since the push. ``recovery_time`` [s]: from
    the push until the center of mass moves below 0.1 m/s for good; NaN if the robot fell or still
    moved at the end.

    Strategies, each true or false, several at once: ``stepping``: at least one step. ``jumping``:
    no foot on the floor at the end of a control step. ``foot_tilting``: a sole on the floor
    leans by more than 0.15 rad. ``hip``: pitch or roll of a hip goes 0.25 rad away from its angle
    at the push. ``angular_momentum``: that of the body about its center of mass exceeds 0.05 m h0
    sqrt(g h0). ``ankle``: none of the others, the center of pressure alone. The bounds are ours.

    Source: names of Duburcq et al., "Reactive stepping for humanoid robots using reinforcement
    learning", IROS 2022, table I, which judges by eye.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: HumanoidEnv):
        n, robot = env.num_envs, env.robot
        self.hips = [i for i, name in enumerate(robot.joints) if _bends_at_the_hip(name)]
        unit = robot.mass * robot.com_height * (GRAVITY * robot.com_height) ** 0.5
        self.momentum = MOMENTUM * unit
        self.steps = torch.zeros(n, dtype=torch.long)
        self.displacement = torch.zeros(n)
        self.last_motion = torch.zeros(n)
        self.still = torch.zeros(n, dtype=torch.bool)
        self.seen = torch.zeros(n, dtype=torch.bool)
        flags = ("stepping", "jumping", "foot_tilting", "hip", "angular_momentum")
        self.flags = {name: torch.zeros(n, dtype=torch.bool) for name in flags}
        self._com, self._hip = torch.zeros(n, 2), torch.zeros(n, len(self.hips))  # at the push
        self._feet = Footsteps(n)

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step before the push, the last of which is what it disturbs."""
        self._com, self._hip = td["com_position"][:, :2], td["joint_position"][:, self.hips]
        self._feet.update(td)

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step, of trials up to their fall."""
        counted, since_push = now.upto_fall, now.since_push
        com, contact = td["com_position"][:, :2], td["feet_contact"]
        hip, landed = td["joint_position"][:, self.hips], self._feet.update(td)
        self.seen |= counted
        self.steps += torch.where(counted, landed.sum(-1), 0)
        away = (com - self._com).norm(dim=-1)
        self.displacement = torch.where(counted, away, self.displacement)
        moving = td["com_velocity"].norm(dim=-1) > CALM
        self.last_motion = torch.where(moving & counted, since_push, self.last_motion)
        self.still = torch.where(counted, ~moving, self.still)
        leaning = contact & (tilt(td["feet_orientation"]) > FOOT_TILT)
        used = {
            "stepping": landed.any(-1),
            "jumping": ~contact.any(-1),
            "foot_tilting": leaning.any(-1),
            "hip": ((hip - self._hip).abs() > HIP).any(-1),
            "angular_momentum": td["angular_momentum"].norm(dim=-1) > self.momentum,
        }
        for name, value in used.items():
            self.flags[name] |= value & counted

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Columns ``(N,)``."""
        came_to_rest = self.seen & self.still & ~ended.fell
        others = torch.stack(list(self.flags.values())).any(0)
        return {
            "recovery_time_s": torch.where(came_to_rest, self.last_motion, torch.nan),
            "steps": self.steps,
            "displacement": torch.where(self.seen, self.displacement, torch.nan),
            "strategy/ankle": self.seen & ~others,
            **{f"strategy/{name}": value for name, value in self.flags.items()},
        }


def strategy_table(trials: pd.DataFrame) -> pd.DataFrame:
    """Share of recovered trials in which each strategy was seen, by side and size of the push.

    Rows: ``side`` (a quarter of the directions: forward, left, backward, right), ``impulse``,
    ``recovered``, the number of trials counted; then a share for each strategy.
    """
    counted = trials[trials["recovered"] & (trials["impulse"] > 0)]
    sides = np.array(["forward", "left", "backward", "right"])
    quarter = np.round(counted["direction_rad"].to_numpy() / (np.pi / 2) - 1e-9).astype(int) % 4
    names = [str(name) for name in trials if str(name).startswith("strategy/")]
    groups = counted.assign(side=sides[quarter]).groupby(["side", "impulse"], sort=False)
    table = groups[names].mean().rename(columns=lambda name: name.removeprefix("strategy/"))
    table.insert(0, "recovered", groups.size())
    order = {side: place for place, side in enumerate(sides)}
    return table.reset_index().sort_values(
        ["side", "impulse"],
        key=lambda column: column.map(lambda x: order.get(x, x)),
        ignore_index=True,
    )


def _bends_at_the_hip(joint: str) -> bool:
    return joint.endswith(("hip_pitch", "hip_roll"))
