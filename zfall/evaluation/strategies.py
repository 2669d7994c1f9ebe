"""How a push was met: steps, displacement, time, and the strategies of Duburcq et al., table I."""

from typing import ClassVar

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.followers import Ended, Moment
from zfall.robots import GRAVITY
from zfall.robots.anatomy import hips_of
from zfall.robots.units import factor
from zfall.rotations import tilt

# Of the default robot, and in proportion of others:
STRIDE = 0.02  # a foot that comes down so far from where it left has stepped [m]
CALM = 0.1  # speed of the center of mass below which the robot has come to rest [m/s]
FOOT_TILT = 0.15  # of a sole that stays on the floor [rad]
HIP = 0.25  # of a hip's pitch or roll, away from where it was at the push [rad]
MOMENTUM = 0.05  # angular momentum about the center of mass, in units of m h0 sqrt(g h0)

# Strategy: the column that tells how much of it was used, and more than how much of it counts.
AMOUNTS = {
    "stepping": ("steps", 0.0),
    "jumping": ("flight_s", 0.0),
    "foot_tilting": ("foot_tilt_rad", FOOT_TILT),
    "hip": ("hip_rad", HIP),
    "angular_momentum": ("angular_momentum", MOMENTUM),
}
USUAL = 0.95  # quantile of the control trials: what more than so many do with no push is its effect


class Footsteps:
    """Sees feet come down at least 2 cm, of the default robot, from where they had left the floor.

    Args:
        env: the base env.
    """

    def __init__(self, env: HumanoidEnv):
        worlds, self.stride = env.num_envs, STRIDE * factor(env.robot, "length")
        self._contact = torch.ones(worlds, 2, dtype=torch.bool)  # in the last step
        self._left: Tensor | None = None  # where they stood last

    def update(self, td: TensorDictBase) -> Tensor:
        """Takes in a control step; returns which feet have just stepped ``(N, 2)`` bool."""
        contact, feet = td["feet_contact"], td["feet_position"][..., :2]
        stood = feet if self._left is None else self._left
        landed = contact & ~self._contact & ((feet - stood).norm(dim=-1) > self.stride)
        self._contact = contact
        self._left = torch.where(contact[..., None], feet, stood)
        return landed


class Strategies:
    """Follows the feet, hips and momenta from the push until a trial ends.

    ``steps``: times that a foot came down at least 2 cm from where it had left the floor.
    ``displacement`` [m]: of the center of mass, level, since the push. ``recovery_time`` [s]: from
    the push until the center of mass moves below 0.1 m/s for good; NaN if the robot fell or still
    moved at the end. Both bounds are in proportion on other robots.

    Amounts: ``flight_s`` [s]: control steps at whose end no foot touches the floor. Largest
    values: ``foot_tilt_rad``, the lean of a sole on the floor; ``hip_rad``, how far pitch or roll
    of a hip is from its angle at the push; ``angular_momentum`` of the body about its center of
    mass, in units of m h0 sqrt(g h0).

    Strategies, each true or false, several at once: an amount above its bound in ``AMOUNTS``.
    ``ankle``: none of the others, the center of pressure alone. The bounds are ours.

    Source: names of Duburcq et al., "Reactive stepping for humanoid robots using reinforcement
    learning", IROS 2022, table I, which judges by eye.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: HumanoidEnv):
        n, robot = env.num_envs, env.robot
        self.hips = hips_of(robot)
        self.unit = robot.mass * robot.com_height * (GRAVITY * robot.com_height) ** 0.5
        self.control_dt = env.control_dt
        self.displacement = torch.zeros(n)
        self.last_motion = torch.zeros(n)
        self.still = torch.zeros(n, dtype=torch.bool)
        self.seen = torch.zeros(n, dtype=torch.bool)
        self.steps = torch.zeros(n, dtype=torch.long)
        self.flights = torch.zeros(n, dtype=torch.long)  # control steps
        self.largest = {name: torch.zeros(n) for name in ("foot_tilt", "hip", "momentum")}
        self._com, self._hip = torch.zeros(n, 2), torch.zeros(n, len(self.hips))  # at the push
        self._feet = Footsteps(env)
        self.calm = CALM * factor(robot, "speed")

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
        self.flights += counted & ~contact.any(-1)
        away = (com - self._com).norm(dim=-1)
        self.displacement = torch.where(counted, away, self.displacement)
        moving = td["com_velocity"].norm(dim=-1) > self.calm
        self.last_motion = torch.where(moving & counted, since_push, self.last_motion)
        self.still = torch.where(counted, ~moving, self.still)
        now_used = {
            "foot_tilt": (tilt(td["feet_orientation"]) * contact).amax(-1),
            "hip": torch.nn.functional.pad((hip - self._hip).abs(), (0, 1)).amax(-1),  # 0 of none
            "momentum": td["angular_momentum"].norm(dim=-1) / self.unit,
        }
        for name, value in now_used.items():
            largest = self.largest[name]
            self.largest[name] = torch.where(counted, torch.maximum(largest, value), largest)

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Columns ``(N,)``."""
        came_to_rest = self.seen & self.still & ~ended.fell
        amounts = {
            "steps": self.steps,
            "flight_s": self.flights * self.control_dt,
            "foot_tilt_rad": self.largest["foot_tilt"],
            "hip_rad": self.largest["hip"],
            "angular_momentum": self.largest["momentum"],
        }
        used = {name: amounts[column] > bound for name, (column, bound) in AMOUNTS.items()}
        return {
            "recovery_time_s": torch.where(came_to_rest, self.last_motion, torch.nan),
            "displacement": torch.where(self.seen, self.displacement, torch.nan),
            **amounts,
            "strategy/ankle": self.seen & ~torch.stack(list(used.values())).any(0),
            **{f"strategy/{name}": value for name, value in used.items()},
        }


def strategy_table(trials: pd.DataFrame) -> pd.DataFrame:
    """Share of recovered trials with more of a strategy than without a push, by side and size.

    A strategy counts if its amount is above the bound of ``AMOUNTS`` and above what 95 % of the
    control trials did not exceed, which are as long and have no push. So a policy that steps all
    the time is seen to step only where it takes more steps than it does by itself. By chance
    about 5 % of the trials exceed what is usual.

    Rows: ``side`` (a quarter of the directions: forward, left, backward, right), ``impulse``,
    ``recovered``, the number of trials counted; then a share for each strategy. ``ankle`` goes by
    the bounds alone; ``as_usual``: nothing exceeds the control trials. The first row, of ``side``
    "no push", has the control trials by the bounds alone. Shares are NaN if no control trial
    recovered. Without all amounts, as in a battery with other measures, no strategy is shown.
    """
    columns = [column for column, _ in AMOUNTS.values()]
    known = all(column in trials and trials[column].notna().all() for column in columns)
    names = ["ankle", *AMOUNTS, "as_usual"] if known else []
    control = trials[trials["recovered"] & (trials["impulse"] == 0)]
    counted = trials[trials["recovered"] & (trials["impulse"] > 0)].copy()
    if known:
        for name, more in beyond_usual(trials, counted).items():
            counted[name] = more
        counted["ankle"] = counted["strategy/ankle"]
        beyond = counted[list(AMOUNTS)].sum(axis=1)
        counted["as_usual"] = (beyond == 0).astype(float) if len(control) else np.nan
    sides = np.array(["forward", "left", "backward", "right"])
    quarter = np.round(counted["direction_rad"].to_numpy() / (np.pi / 2) - 1e-9).astype(int) % 4
    groups = counted.assign(side=sides[quarter]).groupby(["side", "impulse"], sort=False)
    table = groups[names].mean()
    table.insert(0, "recovered", groups.size())
    order = {side: place for place, side in enumerate(sides)}
    pushed = table.reset_index().sort_values(
        ["side", "impulse"], key=lambda column: column.map(lambda x: order.get(x, x))
    )
    if not known or not len(control):
        return pushed.reset_index(drop=True)
    alone = control[[f"strategy/{name}" for name in ["ankle", *AMOUNTS]]].mean()
    alone = alone.rename(lambda name: str(name).removeprefix("strategy/"))
    first = pd.DataFrame([{"side": "no push", "impulse": 0.0, "recovered": len(control), **alone}])
    return pd.concat([first, pushed], ignore_index=True)[["side", "impulse", "recovered", *names]]


def beyond_usual(trials: pd.DataFrame, counted: pd.DataFrame) -> dict[str, pd.Series]:
    """Which trials used more of each strategy than its bound and than usual, 1 or 0.

    Args:
        trials: all of a battery; what is usual is that of the recovered ones without a push. If
            there is none, nothing is known: NaN.
        counted: those that are looked at.
    """
    control = trials[trials["recovered"] & (trials["impulse"] == 0)]
    found = {}
    for name, (column, bound) in AMOUNTS.items():
        more = counted[column] > max(bound, _usual(control[column].to_numpy()))
        found[name] = more.astype(float) if len(control) else more.astype(float) * np.nan
    return found


def _usual(amounts: NDArray[np.float64]) -> float:
    """What 95 % of the control trials do not exceed, one of their values; infinite of none."""
    return float(np.quantile(amounts, USUAL, method="inverted_cdf")) if len(amounts) else np.inf
