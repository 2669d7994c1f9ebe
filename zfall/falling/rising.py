"""What follows trials in which a robot gets up: when it stands, and what each fall has cost."""

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.followers import Ended, Moment
from zfall.falling.modes import RISE
from zfall.falling.standing import stands

HOLD = 0.5  # time of standing without a break that counts [s]
WITHIN = 8.0  # time in which a fall is to end standing [s]
LANDING = 1.0  # time after the first touch that is the landing, not the way up [s]


class Rising:
    """Looks for the moment from which a robot stands for half a second.

    ``stood``: it stands at the end of the trial, and has for half a second. ``stood_s`` [s]: when
    it began to stand for the first half second; NaN if it never did.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ("stood",)

    def __init__(self, env: HumanoidEnv):
        self.robot, self.dt = env.robot, env.control_dt
        self.standing = torch.zeros(env.num_envs)
        self.first = torch.full((env.num_envs,), torch.nan)
        self.time = 0.0

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step."""
        self.update(td, now)

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step."""
        self.time += self.dt
        self.standing = torch.where(stands(td, self.robot), self.standing + self.dt, 0.0)
        new = (self.standing > HOLD - 1e-6) & self.first.isnan()
        self.first = torch.where(new, self.time - self.standing, self.first)

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Columns ``(N,)``."""
        never = torch.full_like(self.first, torch.nan)
        return {
            "stood": (self.standing > HOLD - 1e-6) & ~ended.diverged,
            "stood_s": torch.where(ended.diverged, never, self.first),
        }


class Cycling:
    """Counts falls, how many of them end standing again, and what each of them costs.

    A fall begins when a standing robot touches the floor with anything but its feet, and ends when
    it has stood again for half a second. ``falls``; ``falls_open``: those that began in the last
    eight and a half seconds of the trial, too late to be judged; ``falls_stood``: those of the
    others in which standing began within eight seconds; ``down_s`` [s]: time in falls.
    ``pushes_met``: pushes that began while it was not in a fall; ``pushes_down``: all others.

    Sums over falls, of the first second after the touch: ``landing_force`` [N], the largest of the
    floor on any region but the feet; ``landing_torque`` [N m], the largest of a joint;
    ``landing_vulnerable``: falls in which torso or head touched. ``rise_force`` [N]: as the first,
    of the time after it.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: HumanoidEnv):
        n = env.num_envs
        self.robot, self.dt = env.robot, env.control_dt
        self.struck = [env.regions.index(region) for region in ("torso", "head")]
        self.down, self.pushed = torch.zeros(2, n, dtype=torch.bool)
        self.since, self.standing = torch.zeros(2, n)  # of the fall that goes on [s]
        self.time = 0.0
        self.begun, self.stood = list[tuple[Tensor, Tensor]](), list[tuple[Tensor, Tensor]]()
        self.force, self.torque, self.later = torch.zeros(3, n)  # of it
        self.vulnerable = torch.zeros(n)
        names = ("falls", "pushes_met", "pushes_down", "down_s", "landing_force",
                 "landing_torque", "landing_vulnerable", "rise_force")  # fmt: skip
        self.sums = {name: torch.zeros(n) for name in names}

    @staticmethod
    def remarks(td: TensorDictBase) -> dict[str, Tensor]:
        """That a policy with modes begins to get up."""
        rises = "mode" in td.keys() and td["mode"].shape[-1] > RISE
        return {"gets up": td["mode"][:, RISE] > 0} if rises else {}

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step."""
        self.update(td, now)

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step."""
        self.time += self.dt
        push = (td["push", "force"] != 0).any(-1)
        begins, self.pushed = push & ~self.pushed, push
        self._add("pushes_met", begins & ~self.down)
        self._add("pushes_down", begins & self.down)
        new = now.touched & ~self.down
        self.since = torch.where(new, 0.0, self.since + self.dt)
        for name in ("force", "torque", "later", "vulnerable", "standing"):
            setattr(self, name, getattr(self, name).masked_fill(new, 0.0))
        self.down = self.down | new
        self._add("falls", new)
        self.begun.append((torch.full_like(self.since, self.time), new))
        self._add("down_s", self.down, self.dt)
        body = td["contact_force_peak"][:, :-2].amax(-1)
        landing = self.since < LANDING - 1e-6
        self.force = torch.where(landing, torch.maximum(self.force, body), self.force)
        self.later = torch.where(landing, self.later, torch.maximum(self.later, body))
        torque = td["joint_torque_peak"].squeeze(-1)
        self.torque = torch.where(landing, torch.maximum(self.torque, torque), self.torque)
        hit = (td["contact_force_peak"][:, self.struck] > 0).any(-1)
        self.vulnerable = torch.maximum(self.vulnerable, (landing & hit).float())
        self.standing = torch.where(stands(td, self.robot), self.standing + self.dt, 0.0)
        ends = self.down & (self.standing > HOLD - 1e-6)
        in_time = ends & (self.since - self.standing <= WITHIN + 1e-6)
        self.stood.append((self.time - self.since, in_time))  # when these falls began
        self._end(ends)

    def _add(self, name: str, rows: Tensor, value: Tensor | float = 1.0) -> None:
        self.sums[name] += torch.where(rows, torch.as_tensor(value), 0.0)

    def _end(self, rows: Tensor) -> None:
        """Ends the falls of these worlds, and adds what they have cost."""
        self._add("landing_force", rows, self.force)
        self._add("landing_torque", rows, self.torque)
        self._add("landing_vulnerable", rows, self.vulnerable)
        self._add("rise_force", rows, self.later)
        self.down = self.down & ~rows

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Columns ``(N,)``; a fall that goes on is open until it is too late."""
        self._end(self.down.clone())
        last = self.time - WITHIN - HOLD + 1e-6  # when a fall began at the latest that is judged
        late = sum(((time > last) & new).float() for time, new in self.begun)
        stood = sum(((time <= last) & which).float() for time, which in self.stood)
        none = torch.zeros_like(self.since)
        return self.sums | {"falls_open": none + late, "falls_stood": none + stood}
