"""How a trial that was not recovered from ends: on the knees or not, and how hard."""

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.followers import Ended, Moment
from zfall.falling.terms import resting_kneel

HOLD = 0.5  # time without a break that makes a kneel stable [s]
RECOVER, KNEEL = 0, 1  # positions in ``mode``


class Kneeling:
    """Looks for a stable kneel, and adds up what the floor did to each region.

    ``kneeled``: it fell, and at the end of the trial it has been a ``resting_kneel`` for half a
    second. ``trigger_s`` [s]: from the push's begin to the trigger, the first step in mode KNEEL
    or, without modes, the first touch; NaN if it came before the push, which ``gave_up_before``
    says. ``kneel_time_s`` [s]: from the trigger until the kneel had been
    stable for half a second. ``impact_energy`` [J]: ``m |v|^2 / 2`` with v the velocity of the
    center of mass one control step before anything but the feet touched.
    ``contact_impulse/REGION`` [N s]: time integral of the floor's force.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ("kneeled",)

    def __init__(self, env: HumanoidEnv):
        n = env.num_envs
        self.robot, self.regions, self.dt = env.robot, env.regions, env.control_dt
        self.mass, self._parameters = env.mass, env.parameters
        self.rested = torch.zeros(n)
        self.early = torch.zeros(n, dtype=torch.bool)
        self.trigger, self.stable = torch.full((n,), torch.nan), torch.full((n,), torch.nan)
        self.impulse = torch.zeros(n, len(env.regions))
        self.energy = torch.full((n,), torch.nan)
        self._speed: Tensor | None = None

    @property
    def kneeled(self) -> Tensor:
        """Trials that are in a stable kneel now ``(N,)`` bool."""
        return self.rested > HOLD - 1e-6

    @staticmethod
    def remarks(td: TensorDictBase) -> dict[str, Tensor]:
        """That a policy with modes gives up standing."""
        return {"gives up standing": td["mode"][:, KNEEL] > 0} if "mode" in td.keys() else {}

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step before the push."""
        self.early |= td["mode"][:, RECOVER] == 0 if "mode" in td.keys() else now.touched

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step after the push, until the trial is settled."""
        counted, first, since_push = now.counted, now.first, now.since_push
        resting = resting_kneel(td, td, robot=self.robot).squeeze(-1)
        before = self.kneeled
        rested = torch.where(resting, self.rested + self.dt, 0.0)
        self.rested = torch.where(counted, rested, self.rested)
        self.stable = torch.where(self.kneeled & ~before, since_push, self.stable)
        triggered = td["mode"][:, KNEEL] > 0 if "mode" in td.keys() else first
        new = triggered & counted & self.trigger.isnan() & ~self.early
        self.trigger = torch.where(new, since_push, self.trigger)
        self.impulse += counted[:, None] * td["contact_impulse"]
        speed = td["com_velocity"].norm(dim=-1)
        before_it = speed if self._speed is None else self._speed
        own = self._parameters.mass  # of each world, where they differ
        mass = self.mass if own is None else own[:, 0]
        self.energy = torch.where(first, 0.5 * mass * before_it.square(), self.energy)
        self._speed = speed

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Columns ``(N,)``; nothing of the floor's for a trial that was over before the push."""
        impulse = torch.where(ended.before_push[:, None], torch.nan, self.impulse)
        took = torch.where(self.kneeled, self.stable - self.trigger, torch.nan)
        return {
            "kneeled": self.kneeled & ended.fell & ~ended.diverged,
            "kneel_time_s": took,
            "trigger_s": self.trigger,
            "gave_up_before": self.early,
            "impact_energy": self.energy,
            **{f"contact_impulse/{r}": impulse[:, i] for i, r in enumerate(self.regions)},
        }
